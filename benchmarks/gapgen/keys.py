"""Secret keys as the command line takes them."""

from pathlib import Path


def read_key(text: str) -> str:
    """The key itself, or the content of the file that ``@PATH`` names."""
    return Path(text[1:]).read_text(encoding="utf-8").strip() if text.startswith("@") else text
