"""A small server for pages: this machine alone, one page and a few answers in JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from twistcap.errors import InputError

Answer = Callable[[Mapping[str, Any]], Mapping[str, Any]]  # JSON object in, JSON object out
_LOCAL = ("127.0.0.1", "localhost")
_LARGEST = 1 << 22  # bytes of a question


def page_server(page: str, answers: Mapping[str, Answer] | None = None, port: int = 0) -> ThreadingHTTPServer:
    """A server on 127.0.0.1 that gives `page` at ``/`` and answers POSTs; call ``serve_forever``.

    An `InputError` of an answer goes to the page as ``{"error": sentence}``. Requests that name another host are
    refused, so that no other page of the browser can reach it. Port 0 takes a free one. Raises InputError for a port
    that cannot be had.
    """
    content, known = page.encode(), dict(answers or {})

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if not self._is_local():
                return
            if self.path.split("?")[0] == "/":
                self._reply(200, "text/html; charset=utf-8", content)
            else:
                self._reply(404, "text/plain", b"not here")

        def do_POST(self) -> None:
            if not self._is_local():
                return
            answer = known.get(self.path)
            if answer is None or self.headers.get_content_type() != "application/json":
                self._reply(404, "text/plain", b"not here")
                return
            header = self.headers.get("Content-Length", "")
            length = int(header) if header.isdigit() else 0
            reply = _answered(answer, self.rfile.read(min(length, _LARGEST)))
            self._reply(200, "application/json", json.dumps(reply, allow_nan=False).encode())

        def _is_local(self) -> bool:
            local = self.headers.get("Host", "").rsplit(":", 1)[0] in _LOCAL
            if not local:
                self._reply(403, "text/plain", b"this server answers its own machine alone")
            return local

        def _reply(self, status: int, kind: str, body: bytes) -> None:
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: Any) -> None:
            """Requests are not worth a line each."""

    try:
        return ThreadingHTTPServer(("127.0.0.1", port), Handler)
    except (OSError, OverflowError) as error:
        raise InputError(f"port {port} cannot be used ({error}); give another with --port.") from error


def _answered(answer: Answer, body: bytes) -> Mapping[str, Any]:
    try:
        question = json.loads(body)
        if not isinstance(question, dict):
            return {"error": "the question must be a JSON object."}
        return answer(question)
    except InputError as error:
        return {"error": str(error)}
    except ValueError as error:
        return {"error": f"the question cannot be read: {error}."}
