"""A seal opens with its key alone and breaks with its contents."""

import json
from pathlib import Path

import pytest

from benchmarks.gapgen.keys import read_key
from benchmarks.gapgen.score import log_submission, read_answers
from benchmarks.gapgen.seal import merkle_root, seal, unseal

KEY = "0123456789abcdef"
TEXT = '{"id": "a", "effects": ["none"]}\n{"id": "b", "effects": ["creep"]}\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in "abc":
        (tmp_path / "data" / name).mkdir(parents=True)
        (tmp_path / "data" / name / "real_0.csv").write_text(f"t,q0\n0,{ord(name)}\n")
    (tmp_path / "answers.jsonl").write_text(TEXT)
    return tmp_path


def test_a_sealed_split_opens_with_its_key_alone(folder: Path) -> None:
    document = seal("blind", KEY, folder)
    assert document["recordings"] == 2
    assert not (folder / "answers.jsonl").exists()
    assert b"creep" not in (folder / "answers.jsonl.enc").read_bytes()
    assert unseal(KEY, folder) == TEXT
    with pytest.raises(ValueError, match="does not open"):
        unseal(KEY[::-1], folder)


def test_every_change_breaks_the_seal(folder: Path) -> None:
    seal("blind", KEY, folder)
    data = folder / "data" / "b" / "real_0.csv"
    before = data.read_text()
    data.write_text(before.replace("98", "99"))
    with pytest.raises(ValueError, match="data files"):
        unseal(KEY, folder)
    data.write_text(before)
    document = json.loads((folder / "SEAL.json").read_text())
    (folder / "SEAL.json").write_text(json.dumps(document | {"answers_sha256": "0" * 64}))
    with pytest.raises(ValueError, match=r"SEAL\.json"):
        unseal(KEY, folder)
    (folder / "SEAL.json").write_text(json.dumps(document | {"metrics_version": "0"}))
    with pytest.raises(ValueError, match="metrics"):
        unseal(KEY, folder)
    blob = bytearray((folder / "answers.jsonl.enc").read_bytes())
    blob[-1] ^= 1
    (folder / "answers.jsonl.enc").write_bytes(blob)
    with pytest.raises(ValueError, match="altered"):
        unseal(KEY, folder)


def test_the_root_is_of_names_and_contents(folder: Path) -> None:
    root = merkle_root(folder / "data")
    (folder / "data" / "a").rename(folder / "data" / "d")
    assert merkle_root(folder / "data") != root
    (folder / "data" / "d").rename(folder / "data" / "a")
    assert merkle_root(folder / "data") == root


def test_marks_of_a_workflow_are_no_data(folder: Path) -> None:
    seal("blind", KEY, folder)
    (folder / "data" / ".snakemake_timestamp").touch()
    assert unseal(KEY, folder) == TEXT
    (folder / "data" / "a" / "more.csv").touch()
    with pytest.raises(ValueError, match="data files"):
        unseal(KEY, folder)


def test_a_key_that_can_be_guessed_is_refused(folder: Path) -> None:
    with pytest.raises(ValueError, match="guessed"):
        seal("blind", "short", folder)
    path = folder / "key"
    path.write_text(KEY + "\n")
    assert read_key(f"@{path}") == KEY


def test_openings_are_counted(folder: Path) -> None:
    seal("blind", KEY, folder)
    with pytest.raises(ValueError, match="give its key"):
        read_answers(folder / "SEAL.json", None)
    assert [a["id"] for a in read_answers(folder / "SEAL.json", KEY)] == ["a", "b"]
    scores = {"top1_class": {"value": 0.5}}
    assert [log_submission(folder / "SEAL.json", folder / "data", "tree", scores) for _ in range(2)] == [1, 2]
