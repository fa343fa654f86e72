"""Secret keys: as the command line takes them, and drawn by ``python -m benchmarks.gapgen.keys FILE``.

A key is drawn once: a file that is there is kept. Only its owner can read it.
"""

import argparse
import os
import secrets
from pathlib import Path

KEY_BYTES = 32


def read_key(text: str) -> str:
    """The key itself, or the content of the file that ``@PATH`` names."""
    return Path(text[1:]).read_text(encoding="utf-8").strip() if text.startswith("@") else text


def draw_key(path: Path) -> bool:
    """Write a random key to ``path`` unless something is there already; returns whether it was drawn."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        return False
    with os.fdopen(handle, "w", encoding="utf-8") as stream:
        stream.write(secrets.token_hex(KEY_BYTES) + "\n")
    return True


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", type=Path, help="file of the key")
    args = parser.parse_args(argv)
    print("drawn" if draw_key(args.file) else "kept")


if __name__ == "__main__":
    main()
