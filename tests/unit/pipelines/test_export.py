"""A run as an MCAP file: read back, opened by the library's own reader, with energies that obey physics."""

import json
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from lagsplat.chart.chart import save_chart
from lagsplat.cli.main import main
from lagsplat.config.compose import compose
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.io.config import McapConfig, McapInputConfig
from lagsplat.io.recording.recording import save_recording
from lagsplat.io.robot_log.recording import read_log
from lagsplat.pipelines.export import encoded_motion, energies, export_mcap, predict
from lagsplat.runs.run import FittedRun
from lagsplat.stage1.autoencoder import decode_latents, save_autoencoder
from lagsplat.stage2.fit import save_dynamics
from lagsplat.video_quality.frames import FrameSettings
from tests.unit.evaluate import tiny_run


@pytest.fixture(scope="module")
def run() -> FittedRun:
    film, model = tiny_run.recording(120, tail=40), tiny_run.autoencoder()
    return FittedRun(film, model, tiny_run.chart(model, film), tiny_run.lagrangian())


@pytest.fixture(scope="module")
def settings() -> EvaluateConfig:
    return compose("evaluate.skip_s=0.1").evaluate


@pytest.fixture(scope="module")
def exported(run: FittedRun, settings: EvaluateConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("export") / "run.mcap"
    export_mcap(run, settings, path)
    return path


def test_our_reader_finds_the_recording_in_it(run: FittedRun, exported: Path) -> None:
    inputs = [McapInputConfig("/inputs", "push", "push", "N")]
    topics = McapConfig("/camera/recorded", inputs, "header", 0.5)
    read = read_log(exported, topics, FrameSettings())
    np.testing.assert_array_equal(read.frames, run.recording.frames)
    np.testing.assert_allclose(read.time_s, run.recording.time_s, atol=1e-9)
    np.testing.assert_allclose(read.inputs, run.recording.inputs, atol=1e-7)


def test_the_libraries_own_reader_finds_every_topic(run: FittedRun, exported: Path) -> None:
    with exported.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found: dict[str, list] = {}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            found.setdefault(channel.topic, []).append((schema, message))
        assert sorted(found) == [
            "/camera/prediction",
            "/camera/reconstruction",
            "/camera/recorded",
            "/energy/encoded",
            "/energy/predicted",
            "/inputs",
            "/latent/encoded",
            "/latent/predicted",
        ]
        assert found["/camera/recorded"][0][0].name == "foxglove.CompressedImage"
        schema, message = found["/latent/encoded"][7]
        assert json.loads(schema.data)["properties"]["q"]["type"] == "array"
        np.testing.assert_array_equal(json.loads(message.data)["q"], run.chart.latents[7])
        assert len(found["/camera/prediction"]) == len(found["/latent/predicted"]) == 54
        decoded = [m.decoded_message for m in reader.iter_decoded_messages(topics=["/camera/reconstruction"])]
    drawn = cv2.imdecode(np.frombuffer(decoded[7].data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    expected = decode_latents(run.autoencoder, run.chart.to_raw(run.chart.latents[7:8]))[0]
    np.testing.assert_allclose(drawn, 255.0 * np.clip(np.moveaxis(expected, 0, 2), 0, 1), atol=0.51)


def test_the_prediction_starts_at_the_first_scored_frame(run: FittedRun, settings: EvaluateConfig) -> None:
    motion = predict(run, settings)
    smooth = run.chart.held_out.smoothed(run.chart.smoothing_frames).latents
    skip = round(0.1 / run.chart.dt_s)
    assert motion.frames[0] == run.chart.n_train + skip
    assert motion.frames[-1] == run.recording.n_frames - 1
    np.testing.assert_array_equal(motion.q[0], smooth[skip])
    with pytest.raises(ValueError, match="skip_s"):
        predict(run, compose("evaluate.skip_s=0.99").evaluate)


def test_the_total_energy_falls_by_what_damping_takes(run: FittedRun, settings: EvaluateConfig) -> None:
    motion = predict(run, settings)
    parts = energies(run.lagrangian, motion.q, motion.v)
    assert min(parts["kinetic"].min(), parts["potential"].min(), parts["dissipated_power"].min()) >= 0
    power, dt_s = parts["dissipated_power"], run.chart.dt_s
    taken = np.sum(dt_s * (power[1:] + power[:-1]) / 2)
    lost = parts["total"][0] - parts["total"][-1]
    assert lost > 0.1 * parts["total"][0]
    assert lost == pytest.approx(taken, rel=0.02)


def test_velocities_are_those_of_each_clip(run: FittedRun) -> None:
    whole = run.chart.whole
    clips = type(whole)(whole.latents, whole.inputs, whole.time_s, ((0, 1), (1, 60), (60, 120)))
    motion = encoded_motion(clips, 1.0)
    np.testing.assert_array_equal(motion.frames, np.arange(1, 120))  # one frame has no velocity
    first = (motion.q[1] - motion.q[0]) / run.chart.dt_s
    np.testing.assert_allclose(motion.v[0], first)


def test_the_command_writes_once_and_overwrites_nothing(
    run: FittedRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    header = {"config": asdict(compose())}
    save_recording(tmp_path / "recording.safetensors", run.recording)
    save_autoencoder(tmp_path / "autoencoder.safetensors", run.autoencoder, header)
    save_chart(tmp_path / "chart.safetensors", run.chart, header)
    save_dynamics(tmp_path / "dynamics.safetensors", run.lagrangian, header)
    words = ["export", str(tmp_path), "--mcap", "evaluate.skip_s=0.1"]
    assert main(words) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "run.mcap")
    before = (tmp_path / "run.mcap").read_bytes()
    assert main(words) == 2
    assert "is there already" in capsys.readouterr().err
    assert (tmp_path / "run.mcap").read_bytes() == before
    assert main([*words, f"out={tmp_path / 'other.mcap'}"]) == 0
    assert (tmp_path / "other.mcap").is_file()


@pytest.mark.parametrize("words", [["a"], ["--mcap"], ["a", "--obj"], ["a", "b", "--mcap"]])
def test_what_is_no_export_is_refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", *words]) == 2
    assert "lagsplat export FOLDER --mcap" in capsys.readouterr().err
