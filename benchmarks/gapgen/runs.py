"""What to diagnose once more: ``python -m benchmarks.gapgen.runs --answers SEAL.json --key KEY --out FILE``.

``FILE`` gets one line a recording, ``{"id": ..., "without": [...]}``: the true effect and what cannot be told
from it, which are to be left out of the catalogue. It gives answers away, so it is made after the
predictions proper.
"""

import argparse
import json
from pathlib import Path

from benchmarks.gapgen.score import read_answers, runs_to_make


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--answers", type=Path, required=True, help="answers.jsonl or SEAL.json")
    parser.add_argument("--key", help="key of a sealed split, or @FILE")
    parser.add_argument("--most", type=int, required=True, help="number of runs at most")
    parser.add_argument("--out", type=Path, required=True, help="file to write")
    args = parser.parse_args(argv)
    # names are random, so that the first ones are a random choice
    runs = sorted(runs_to_make(read_answers(args.answers, args.key)), key=lambda run: run["id"])[: args.most]
    args.out.write_text("".join(json.dumps(run) + "\n" for run in runs), encoding="utf-8")
    print(len(runs))


if __name__ == "__main__":
    main()
