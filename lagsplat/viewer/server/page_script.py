"""A script that is added to viser's page: arrow keys that push, and what else the page lacks."""

import gzip
from functools import cache
from importlib.resources import files

from websockets.http11 import Response

END = b"</body>"


def add_page_script(response: Response) -> Response:
    """Add ``page.js`` to an answer that is a page; other files stay as they are."""
    if "text/html" in response.headers.get("Content-Type", ""):
        response.body = _insert(
            bytes(response.body), packed=response.headers.get("Content-Encoding") == "gzip"
        )
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))
    return response


@cache
def _insert(body: bytes, *, packed: bool) -> bytes:
    page = gzip.decompress(body) if packed else body
    source = files("lagsplat.viewer.server").joinpath("page.js").read_bytes()
    head, end, tail = page.rpartition(END)
    page = head + b"<script>\n" + source + b"</script>" + end + tail
    return gzip.compress(page, compresslevel=6) if packed else page
