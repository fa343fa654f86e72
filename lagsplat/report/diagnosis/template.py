"""The page of a diagnosis: its form and its style. A module, so that a change of it makes reports anew."""

STYLE = """
:root { color-scheme: light; --ink: #1b1b1b; --soft: #555; --rule: #d5d5d5; --blue: #0072b2;
  --orange: #d55e00; --green: #00795a; --ground: #f6f6f4; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 2rem 1.2rem 4rem; max-width: 7.6in; background: #fff; color: var(--ink);
  font: 11pt/1.45 Georgia, "Times New Roman", serif; overflow-wrap: break-word; }
h1, h2, h3, table, .chip, .tag, figcaption, .tile, footer, code, nav {
  font-family: "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 19pt; line-height: 1.2; margin: 0 0 .2rem; }
h2 { font-size: 13pt; margin: 2rem 0 .5rem; padding-bottom: .15rem; border-bottom: 1px solid var(--rule); }
h3 { font-size: 10.5pt; margin: 1.4rem 0 .3rem; }
.kicker { font: 9.5pt "Helvetica Neue", Arial, sans-serif; color: var(--soft); margin-bottom: .4rem; }
.lead { font-size: 12pt; border-left: 3px solid var(--orange); padding: .1rem 0 .1rem .9rem;
  margin: 1.2rem 0; }
.lead.none { border-color: var(--green); } .lead.undetermined, .lead.unknown { border-color: var(--soft); }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(1.15in, 1fr)); gap: .5rem;
  margin: .6rem 0; }
.tile { background: var(--ground); padding: .45rem .6rem; font-size: 9pt; color: var(--soft); }
.tile b { display: block; font-size: 12.5pt; color: var(--ink); font-weight: 600; }
.row { font: 9.5pt/1.7 "Helvetica Neue", Arial, sans-serif; margin: .25rem 0; }
.row b { display: inline-block; min-width: 1.45in; font-weight: 600; }
.chip { font-size: 8.5pt; padding: .05rem .4rem; border: 1px solid var(--rule); border-radius: 3px;
  white-space: nowrap; display: inline-block; line-height: 1.45; margin: 0 .12rem .12rem 0; }
.chip.yes { border-color: var(--green); } .chip.weak { border-style: dashed; }
.chip.no { color: var(--soft); background: var(--ground); text-decoration: line-through; }
.tag { font-size: 8pt; padding: 0 .35rem; border-radius: 3px; color: #fff; background: var(--soft); }
.tag.warn { background: #9a5b00; } .tag.undetermined, .tag.refuse { background: #a02000; }
ul { padding-left: 1.1rem; margin: .4rem 0; } li { margin: .2rem 0; }
table { border-collapse: collapse; width: 100%; font-size: 8.5pt; line-height: 1.35; }
th { text-align: left; border-bottom: 1.5px solid var(--ink); font-weight: 600; vertical-align: bottom; }
th, td { padding: .22rem .5rem .22rem 0; } td { border-bottom: 1px solid var(--rule); vertical-align: top; }
td.n, th.n { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
tr.chosen td { background: #fdf1e7; } tr.verdict td { color: var(--soft); }
.wide { overflow-x: auto; }
figure { margin: 1.3rem 0; break-inside: avoid; }
figure svg, figure img { max-width: 100%; height: auto; display: block; }
figcaption { font-size: 8.8pt; color: var(--soft); margin-top: .3rem; } figcaption b { color: var(--ink); }
pre, code { font: 8.5pt/1.4 Menlo, Consolas, monospace; } pre { background: var(--ground); padding: .6rem;
  white-space: pre-wrap; overflow-wrap: anywhere; margin: .4rem 0; }
td code { overflow-wrap: anywhere; }
.film span { display: inline-block; width: 33%; text-align: center; font: 8.8pt Arial, sans-serif; }
.film img { width: 100%; }
@page { size: A4; margin: 16mm 15mm; }
@media print { body { padding: 0; max-width: none; font-size: 10pt; } h2, h3 { break-after: avoid; }
  tr, li, .tile { break-inside: avoid; } .lead { font-size: 11pt; }
  .tile, .chip.no, tr.chosen td, .tag { print-color-adjust: exact; -webkit-print-color-adjust: exact; } }
"""

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ headline }} · diagnosis of the sim-to-real gap</title>
<style>{{ style | safe }}</style>
</head>
<body>
<header>
<div class="kicker">Diagnosis of the sim-to-real gap{% if files %} · {{ files | join(", ") }}{% endif %}</div>
<h1>{{ headline }}</h1>
</header>

<section aria-label="The data">
<h2>Before anything is fitted: the data</h2>
<div class="tiles">
{% for tile in tiles %}<div class="tile"><b>{{ tile.value }}</b>{{ tile.label }}</div>
{% endfor %}</div>
{% if findings %}<ul>
{% for one in findings %}<li><span class="tag {{ one.level }}">{{ one.level }}</span>
{{ one.source }}: {{ one.what }}.{% if one.why %} {{ one.why | sentence }}{% endif %}
{% if one.remedy %}<em>{{ one.remedy | sentence }}</em>{% endif %}</li>
{% endfor %}</ul>{% elif checked %}<div class="row">The checks of the data found nothing to object to.</div>
{% else %}<div class="row">The quality of the data was not checked.</div>{% endif %}
{% for row in shown %}<div class="row"><b>{{ row.label }}</b>
{% for name in row.names %}<span class="chip {{ row.grade }}">{{ name }}</span>{% endfor %}</div>
{% endfor %}{% if not shown %}<div class="row">What this recording can show was not computed.</div>{% endif %}
{% for names in equivalent %}<div class="row"><b>Not told apart</b>
{% for name in names %}<span class="chip">{{ name }}</span>{% if not loop.last %} or {% endif %}
{% endfor %}</div>
{% endfor %}</section>

<section aria-label="The verdict">
<h2>What was found</h2>
<p class="lead {{ verdict }}">{{ paragraph | unbroken }}</p>
{% if advice %}<h3>Record this next</h3>
<ul>{% for one in advice %}<li>{{ one | sentence }}</li>{% endfor %}</ul>{% endif %}
{% if warnings %}<h3>Keep in mind</h3>
<ul>{% for one in warnings %}<li>{{ one | sentence }}</li>{% endfor %}</ul>{% endif %}
{% if absorbed %}<div class="row"><b>Absorbed already</b>
{% for name in absorbed %}<span class="chip">{{ name }}</span>{% endfor %}
the sim was fitted on the same recording and has taken these up.</div>{% endif %}
</section>

<section aria-label="The figures">
<h2>What it rests on</h2>
{% for one in figures %}<figure id="{{ one.key }}">
{{ one.svg | safe }}
<figcaption><b>Figure {{ loop.index }}. {{ one.title }}.</b> {{ one.caption | unbroken }}</figcaption>
</figure>
{% endfor %}
{% if film %}<figure class="film" id="film"><img src="{{ film | safe }}"
alt="The stretch as measured, as forecast by the sim, and as forecast with the effects, side by side">
<span>measured</span><span>sim</span><span>sim with effects</span>
<figcaption><b>Film.</b> The same stretch side by side{% if slowed > 1.05 %},
slowed down {{ "%.2g" | format(slowed) }} times{% endif %}. Forecasts
begin anew every natural period, or as often as the sim is lost.</figcaption></figure>{% endif %}
{% if missing %}<div class="row"><b>Not computed</b> {{ missing | join("; ") }}.</div>{% endif %}
</section>

<section aria-label="All candidates">
<h2>All candidates</h2>
<div class="wide"><table>
<thead><tr><th>effect</th><th class="n">probability</th><th>parameters, with 90 % intervals</th>
<th class="n">closes</th><th class="n">log evidence<br>over none (nat)</th><th class="n">misfit</th></tr>
</thead>
<tbody>
{% for one in candidates %}<tr class="{{ one.kind }}"><td>{{ one.place }}</td>
<td class="n">{{ one.probability }}</td>
<td>{% for text in one.parameters %}{{ text | unbroken }}{% if not loop.last %}<br>{% endif %}
{% endfor %}</td>
<td class="n">{{ one.closure }}</td><td class="n">{{ one.evidence }}</td>
<td class="n">{{ one.misfit }}</td></tr>
{% endfor %}</tbody></table></div>
<div class="row">Closes: share of the gap above its floor, with the 95 % interval; a wrong effect may close
much, so that it is no proof of a cause. Misfit: mean square of the residual in units of the noise, about 1
where an effect explains everything.</div>
<h3>What the likely ones are</h3>
<ul>{% for one in explained %}<li><b>{{ one.name }}</b>: {{ one.words.what }} <em>How one sees it:</em>
{{ one.words.seen }} <em>What to do:</em> {{ one.words.do }}</li>{% endfor %}</ul>
</section>

{% if excitations %}<section aria-label="What the recording can show">
<h2>What this recording can show, effect by effect</h2>
<div class="wide"><table>
<thead><tr><th>effect</th><th>shown</th><th>because of</th><th>record instead</th></tr></thead>
<tbody>{% for one in excitations %}<tr><td>{{ one.effect }}</td><td><span class="chip {{ one.excited }}">
{{ one.excited }}</span></td><td>{{ one.reason }}</td><td>{{ one.record }}</td></tr>
{% endfor %}</tbody></table></div></section>{% endif %}

<section aria-label="How to reproduce this">
<h2>How to reproduce this</h2>
{% if command %}<pre>{{ command }}</pre>{% endif %}
<div class="wide"><table><tbody>
{% for one in provenance %}<tr><td>{{ one.label }}</td><td><code>{{ one.value }}</code></td></tr>
{% endfor %}</tbody></table></div>
{% if numbers %}<h3>Numbers of the fits</h3>
<div class="wide"><table><tbody>
{% for one in numbers %}<tr><td>{{ one.label }}</td><td>{{ one.value }}</td></tr>
{% endfor %}</tbody></table></div>{% endif %}
<div class="row">Beside this page: <code>diagnosis.json</code> holds these numbers, <code>rollouts.csv</code>
every held-out forecast from which the gap can be computed again.</div>
</section>
</body>
</html>
"""
