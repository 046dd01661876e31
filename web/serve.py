"""Serve this folder on localhost, with the headers that give a page threads.

python serve.py [PORT]

Browsers share memory between threads only where a page is isolated from other origins.  Any other host works too, with
one thread unless it sends these two headers.
"""

from __future__ import annotations

import sys
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

HEADERS = {"Cross-Origin-Opener-Policy": "same-origin", "Cross-Origin-Embedder-Policy": "require-corp"}


class Isolated(SimpleHTTPRequestHandler):
    """Files of a folder, with `HEADERS`."""

    extensions_map = {  # noqa: RUF012
        **SimpleHTTPRequestHandler.extensions_map, ".mjs": "text/javascript", ".wasm": "application/wasm",
    }  # fmt: skip

    def end_headers(self) -> None:
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.send_header("Cache-Control", "no-cache")
        super().end_headers()


if __name__ == "__main__":
    port = int(sys.argv[1]) if len(sys.argv) > 1 else 8000
    server = ThreadingHTTPServer(("127.0.0.1", port), partial(Isolated, directory=str(Path(__file__).parent)))
    print(f"http://localhost:{server.server_port}/", flush=True)
    server.serve_forever()
