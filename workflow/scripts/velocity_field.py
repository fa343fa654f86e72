"""Measure how the primitives of two decoders move at one state."""

from lagsplat.chart.chart import load_chart
from lagsplat.evaluate.velocity_field import fastest_moment, velocity_field
from lagsplat.evaluate.velocity_maps import save_maps
from lagsplat.io.recording import load_recording
from lagsplat.job import Job
from lagsplat.stage1.field import load_field
from lagsplat.stage1.field_config import FieldConfig

with Job(snakemake) as job:
    chart, _ = load_chart(job.input.chart)
    train, _ = load_recording(job.input.recording).split()
    config, moment = job.section(FieldConfig), fastest_moment(chart)
    latents = chart.to_raw(chart.latents[: chart.n_train])
    maps, measures = {}, {}
    for path in job.input.models:
        field, header = load_field(path, config, d=chart.d)
        found, maps[field.kind] = velocity_field(
            field, train.frames, latents, moment, window=job.params.window, neighbours=config.neighbours
        )
        measures[field.kind] = found | {"wall_s": header["wall_s"], "steps": header["steps"]}
    save_maps(job.output.maps, maps, measures, job.header)
