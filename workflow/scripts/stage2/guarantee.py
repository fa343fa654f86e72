"""Ask every trained law whether it comes to rest from anywhere."""

from lagsplat.chart.chart import load_chart
from lagsplat.evaluate.config import GuaranteeConfig
from lagsplat.evaluate.guarantee import measure_guarantee
from lagsplat.planning.job import Job
from lagsplat.report.common.printed_table import write_tables
from lagsplat.report.tables.learned_physics import build_guarantee_table, lay_out_guarantee
from lagsplat.stage2.fit import load_dynamics

with Job(snakemake) as job:
    config, found = job.section(GuaranteeConfig), []
    for dynamics, chart in zip(job.input.dynamics, job.input.charts, strict=True):
        found.append(measure_guarantee(load_dynamics(dynamics)[0], load_chart(chart)[0], config))
        job.say(f"{dynamics}: {found[-1]}")
    table = build_guarantee_table(job.params.runs, found)
    write_tables(job.output, table, lay_out_guarantee(table, titles=job.params.titles))
