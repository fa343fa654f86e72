"""Seal the answers of a split: ``python -m benchmarks.gapgen.seal --split blind-1 --key @KEYFILE --dir DIR``.

``SEAL.json`` is what is published before any prediction: the SHA-256 of salt and answers, the Merkle root
of the data files, the generator's commit and the version of the metrics. The answers are encrypted with
AES-256-GCM beside it as ``answers.jsonl.enc``, the salt within, and the clear text is removed. A key of the
form ``@PATH`` is read from a file.
"""

import argparse
import hashlib
import json
import os
import subprocess
from pathlib import Path
from typing import Any

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from benchmarks.gapgen.keys import read_key

METRICS_VERSION = "2"
SALT_BYTES, NONCE_BYTES, SHORTEST_KEY = 32, 12, 16


def _cipher(key: str) -> AESGCM:
    derived = HKDF(algorithm=SHA256(), length=32, salt=None, info=b"answers").derive(key.encode())
    return AESGCM(derived)


def merkle_root(folder: Path) -> str:
    """Root of the Merkle tree over all files of a folder, by relative path and content, in hexadecimal.

    Leaves and knots are hashed apart, and an odd knot rises unchanged. Hidden files are a workflow's marks
    and no data.
    """
    level = [
        hashlib.sha256(
            b"\0" + str(path.relative_to(folder).as_posix()).encode() + b"\0" + path.read_bytes()
        ).digest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.name.startswith(".")
    ]
    if not level:
        return hashlib.sha256(b"").hexdigest()
    while len(level) > 1:
        pairs = [level[k : k + 2] for k in range(0, len(level), 2)]
        level = [
            hashlib.sha256(b"\1" + b"".join(pair)).digest() if len(pair) == 2 else pair[0] for pair in pairs
        ]
    return level[0].hex()


def _commit() -> str:
    found = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=Path(__file__).parent, capture_output=True, text=True, check=False
    )
    return found.stdout.strip() or "unknown"


def seal(split: str, key: str, folder: Path) -> dict[str, Any]:
    """Encrypt ``answers.jsonl`` of a folder, remove it, and write and return the seal.

    Raises:
        ValueError: if the key is short enough to be guessed.
    """
    if len(key) < SHORTEST_KEY:
        raise ValueError(
            f"a key of {len(key)} characters can be guessed; take {SHORTEST_KEY} random ones or more"
        )
    clear = folder / "answers.jsonl"
    text = clear.read_bytes()
    salt, nonce = os.urandom(SALT_BYTES), os.urandom(NONCE_BYTES)
    hidden = _cipher(key).encrypt(nonce, salt + text, split.encode())
    (folder / "answers.jsonl.enc").write_bytes(nonce + hidden)
    document = {
        "split": split,
        "answers_sha256": hashlib.sha256(salt + text).hexdigest(),
        "data_merkle_root": merkle_root(folder / "data"),
        "recordings": text.count(b"\n"),
        "generator_commit": _commit(),
        "metrics_version": METRICS_VERSION,
    }
    (folder / "SEAL.json").write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    clear.unlink()
    return document


def unseal(key: str, folder: Path) -> str:
    """The answers of a sealed folder, after its seal has been checked.

    Raises:
        ValueError: if the key is wrong, or the answers or the data are not those that were sealed.
    """
    document = json.loads((folder / "SEAL.json").read_text(encoding="utf-8"))
    blob = (folder / "answers.jsonl.enc").read_bytes()
    try:
        opened = _cipher(key).decrypt(blob[:NONCE_BYTES], blob[NONCE_BYTES:], document["split"].encode())
    except InvalidTag as error:
        raise ValueError(f"{folder}: the key does not open the answers, or they were altered") from error
    if hashlib.sha256(opened).hexdigest() != document["answers_sha256"]:
        raise ValueError(f"{folder}: the answers are not those of SEAL.json")
    if merkle_root(folder / "data") != document["data_merkle_root"]:
        raise ValueError(f"{folder}: the data files are not those of SEAL.json")
    if document["metrics_version"] != METRICS_VERSION:
        raise ValueError(
            f"{folder}: sealed for metrics {document['metrics_version']}, these are {METRICS_VERSION}; "
            "score it with the version of its commit"
        )
    return opened[SALT_BYTES:].decode()


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--split", required=True, help="name of the split")
    parser.add_argument("--key", required=True, help="secret key, or @PATH of a file that holds it")
    parser.add_argument("--dir", type=Path, required=True, help="folder that make has written")
    args = parser.parse_args(argv)
    print(json.dumps(seal(args.split, read_key(args.key), args.dir), indent=2))


if __name__ == "__main__":
    main()
