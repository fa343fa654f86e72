"""How soon an exported page shows its first picture, and how many pictures a second it draws in software.

Run as ``nice -n -19 python -m benchmarks.page PAGE.html ...``, which needs Debian's ``chromium`` and ``firefox-esr``. Each
browser opens each page `TURNS` times without a screen, each time with a new profile. The page reports its own clock:
the time from the start of the navigation to its first picture, read back so that it is complete, and the pictures of
`SECONDS` that follow, `SIDE` pixels along their longer side, in a window of 1440 x 900. Browsers draw at most 60 a second.
"""

import json
import os
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

TURNS, SECONDS, SIDE = 3, 10, 256
PATIENCE_S = 60.0
SOFTWARE = ("--disable-gpu", "--enable-unsafe-swiftshader")  # as Chromium draws where there is no GPU
QUIET = (
    'user_pref("browser.shell.checkDefaultBrowser", false);\n'
    'user_pref("datareporting.policy.dataSubmissionEnabled", false);\n'
    'user_pref("toolkit.telemetry.reportingpolicy.firstRun", false);\n'
)
FORBIDS = "default-src 'none'"
MEASURE = """<script>
requestAnimationFrame(function wait() {
  const { splats } = simulation;
  if (!simulation.frames) return requestAnimationFrame(wait);
  splats.gl.readPixels(0, 0, 1, 1, splats.gl.RGBA, splats.gl.UNSIGNED_BYTE, new Uint8Array(4));
  const first = performance.now();
  setTimeout(() => {
    splats.resize(SIDE);
    const gaps = [];
    let before = performance.now();
    requestAnimationFrame(function count(now) {
      gaps.push(now - before);
      before = now;
      const passed = gaps.reduce((sum, gap) => sum + gap);
      if (passed < 1000 * SECONDS) return requestAnimationFrame(count);
      const debug = splats.gl.getExtension("WEBGL_debug_renderer_info");
      const drawn = splats.gl.getParameter(debug ? debug.UNMASKED_RENDERER_WEBGL : splats.gl.RENDERER);
      gaps.sort((a, b) => a - b);
      const answer = { first, rate: (1000 * gaps.length) / passed, slow: gaps[Math.floor(0.99 * gaps.length)] };
      fetch("/report", { method: "POST", body: JSON.stringify({ ...answer, side: splats.side, drawn }) });
    });
  }, 3000);
});
</script></body>"""


def chromium(profile: Path, url: str) -> list[str]:
    return [
        "chromium",
        "--headless",
        "--no-sandbox",
        "--window-size=1440,900",
        f"--user-data-dir={profile}",
        *SOFTWARE,
        url,
    ]


def firefox(profile: Path, url: str) -> list[str]:
    (profile / "user.js").write_text(QUIET)
    return [
        "xvfb-run",
        "-a",
        "-s",
        "-screen 0 1440x900x24",
        "firefox-esr",
        "--kiosk",
        "--profile",
        str(profile),
        "--no-remote",
        url,
    ]


BROWSERS: dict[str, Callable[[Path, str], list[str]]] = {"chromium": chromium, "firefox-esr": firefox}


class Served(BaseHTTPRequestHandler):
    """Serves one page with `MEASURE` in it, and keeps what it reports."""

    def __init__(self, *words: object, page: bytes, reports: list[dict], heard: threading.Event) -> None:
        self.page, self.reports, self.heard = page, reports, heard
        super().__init__(*words)  # type: ignore[arg-type]

    def do_GET(self) -> None:
        self.send_response(200 if self.path == "/" else 404)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.end_headers()
        self.wfile.write(self.page if self.path == "/" else b"")

    def do_POST(self) -> None:
        self.reports.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
        self.send_response(204)
        self.end_headers()
        self.heard.set()

    def log_message(self, *_: object) -> None:
        return


def keep_priority(group: int) -> None:
    """Give the processes of a group the priority of this one: Chromium chooses its own for them."""
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if os.getpgid(int(folder.name)) == group:
                for thread in (folder / "task").iterdir():
                    os.setpriority(os.PRIO_PROCESS, int(thread.name), os.getpriority(os.PRIO_PROCESS, 0))


def measure(page: Path, browser: str) -> dict:
    """Open a page once and return what it reports."""
    measuring = MEASURE.replace("SIDE", str(SIDE)).replace("SECONDS", str(SECONDS))
    text = (
        page.read_text("utf-8")
        .replace(FORBIDS, f"{FORBIDS}; connect-src 'self'")
        .replace("</body>", measuring)
    )
    reports: list[dict] = []
    heard = threading.Event()
    served = partial(Served, page=text.encode(), reports=reports, heard=heard)
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile,
        ThreadingHTTPServer(("127.0.0.1", 0), served) as server,
    ):
        threading.Thread(target=server.serve_forever, daemon=True).start()
        words = BROWSERS[browser](Path(profile), f"http://127.0.0.1:{server.server_port}/")
        process = subprocess.Popen(
            words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        try:
            end = time.monotonic() + PATIENCE_S
            while not heard.wait(0.1):
                keep_priority(process.pid)
                if time.monotonic() > end:
                    raise SystemExit(f"{browser} reported nothing of {page} within {PATIENCE_S:g} s")
        finally:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait()
            server.shutdown()
    return reports[0]


def main() -> None:
    for page in map(Path, sys.argv[1:]):
        for browser in filter(shutil.which, BROWSERS):
            found = [measure(page, browser) for _ in range(TURNS)]
            first, rate, slow = (
                statistics.median(one[key] for one in found) for key in ("first", "rate", "slow")
            )
            print(
                f"{page.name}, {browser}: first picture {1e-3 * first:.2f} s; {rate:.1f} pictures/s at {found[0]['side']} px, "
                f"99 of 100 within {slow:.0f} ms; drawn by {found[0]['drawn']}",
                flush=True,
            )


if __name__ == "__main__":
    main()
