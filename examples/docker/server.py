"""Keypoints over HTTP: POST an image file to /, and get JSON.  Nothing but the runtime and Python's own library.

    python examples/docker/server.py --port 8000
    curl --data-binary @demo/palace.jpg http://localhost:8000/

Pictures wait for one another in the model, which has all threads; reading them and writing JSON overlap.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from elf_runtime import ElfError, ElfRuntime

MOST_BYTES = 20_000_000
elf = ElfRuntime(max_pixels=20_000_000)
turn = threading.Lock()


class Handler(BaseHTTPRequestHandler):
    timeout = 30  # seconds that a client may be silent

    def do_GET(self) -> None:
        self.answer(200, {"model": elf.contract.network, "sha256": elf.sha256})

    def do_POST(self) -> None:
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or not 0 < int(length) <= MOST_BYTES:
            self.answer(413, {"error": f"send an image file of 1 to {MOST_BYTES} bytes, and its Content-Length"})
            return
        with tempfile.NamedTemporaryFile() as file:  # a file is sized up by its header before it is decoded
            file.write(self.rfile.read(int(length)))
            file.flush()
            try:
                with turn:
                    found = elf.detect(file.name)
            except ElfError as error:
                self.answer(422, {"error": str(error).replace(file.name, "the image")})
                return
        descriptors = found.quantized().descriptors  # bytes: see docs/usage.md
        self.answer(200, {"size": found.image_size, "keypoints": found.keypoints.round(3).tolist(),
                          "scores": found.scores.tolist(), "descriptors": descriptors.tolist()})  # fmt: skip

    def answer(self, status: int, data: dict[str, object]) -> None:
        body = json.dumps(data).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=8000)
    args = parser.parse_args()
    elf.warmup()
    with ThreadingHTTPServer((args.host, args.port), Handler) as server:
        print(f"listening on {args.host}:{server.server_port}", flush=True)
        server.serve_forever()


if __name__ == "__main__":
    main()
