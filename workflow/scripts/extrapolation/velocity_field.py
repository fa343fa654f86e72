"""Measure how the primitives of two decoders move at one state."""

from lagsplat.chart.chart import load_chart
from lagsplat.evaluate.velocity_field import compute_velocity_field, find_fastest_moment, save_maps
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job
from lagsplat.stage1.config import PlanarDecoderConfig
from lagsplat.stage1.planar_decoder import load_planar_decoder

with Job(snakemake) as job:
    chart, _ = load_chart(job.input.chart)
    train, _ = load_recording(job.input.recording).split()
    config, moment = job.section(PlanarDecoderConfig), find_fastest_moment(chart)
    latents = chart.to_raw(chart.latents[: chart.n_train])
    maps, measures = {}, {}
    for path in job.input.models:
        decoder, header = load_planar_decoder(path)
        found, maps[decoder.kind] = compute_velocity_field(
            decoder, train.frames, latents, moment, window=job.params.window, neighbours=config.neighbours
        )
        measures[decoder.kind] = found | {"wall_s": header["wall_s"], "steps": header["steps"]}
    save_maps(job.output.maps, maps, measures, job.header)
