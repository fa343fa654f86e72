"""Whether a film's file is as long as it says.

Frame counts cannot tell: an edit list may hide frames of a whole file, and then fewer come out than are
announced. The sizes that the two box formats write into themselves can.
"""

import os

BOX_HEADER = 8
LONG_BOX_HEADER = 16


def missing_bytes(path: str | os.PathLike[str]) -> int | None:
    """How many bytes the file at ``path`` lacks by its own account; None where its format keeps no account.

    Known are MP4 and QuickTime (ISO/IEC 14496-12, section 4.2) and AVI (RIFF, its outermost chunks).
    """
    total = os.path.getsize(path)
    with open(path, "rb") as file:
        first = file.read(BOX_HEADER)
        little_endian = first[:4] == b"RIFF"
        if not little_endian and first[4:] != b"ftyp":
            return None
        position = 0
        while position < total:
            file.seek(position)
            header = file.read(LONG_BOX_HEADER)
            if len(header) < BOX_HEADER:
                return BOX_HEADER - len(header)
            if little_endian:
                size = int.from_bytes(header[4:8], "little")
                position += BOX_HEADER + size + size % 2
                continue
            size = int.from_bytes(header[:4], "big")
            if size == 1:
                size = int.from_bytes(header[8:16], "big")
            if size == 0:  # "to the end of the file"
                return 0
            # A box smaller than its own header is damage; without this floor the walk would stand still.
            position += max(size, BOX_HEADER)
    return position - total
