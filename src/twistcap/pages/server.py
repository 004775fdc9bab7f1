"""A small server for pages: this machine alone, one page and a few answers in JSON, at an address that is secret."""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from twistcap.doors.text import parsed_json
from twistcap.errors import InputError

Answer = Callable[[Mapping[str, Any]], Mapping[str, Any]]  # JSON object in, JSON object out
_LOCAL = ("127.0.0.1", "localhost")
_LARGEST = 1 << 22  # bytes of a question
_MOST, _GREATEST = 20_000, 1e6  # numbers in a list of a question; of one of them, px or degrees
_PATIENCE = 10.0  # s that a connection may be silent


class PageServer(ThreadingHTTPServer):
    """Serves one page and its answers at `url`; other paths of its port are empty."""

    daemon_threads = True

    def __init__(self, page: str, answers: Mapping[str, Answer], port: int) -> None:
        self.token = secrets.token_urlsafe(16)
        self.content, self.answers = page.encode(), dict(answers)
        super().__init__(("127.0.0.1", port), _Handler)

    @property
    def url(self) -> str:
        """The only address; who does not know its token, as other pages and other users, gets nothing."""
        return f"http://127.0.0.1:{self.server_address[1]}/{self.token}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A connection that breaks or is silent is no news."""


class _Handler(BaseHTTPRequestHandler):
    server: PageServer  # type: ignore[assignment]
    timeout = _PATIENCE

    def do_GET(self) -> None:
        if self._is_invited() and self._wanted() == "/":
            self._reply(200, "text/html; charset=utf-8", self.server.content)
        else:
            self._reply(404, "text/plain", b"not here")

    def do_POST(self) -> None:
        answer = self.server.answers.get(self._wanted()) if self._is_invited() else None
        length = self.headers.get("Content-Length", "")
        if answer is None or self.headers.get_content_type() != "application/json":
            self._reply(404, "text/plain", b"not here")
        elif not (length.isascii() and length.isdigit()):
            self._reply(411, "text/plain", b"say how long the question is")
        elif len(length) > 9 or int(length) > _LARGEST:
            self._reply(413, "text/plain", b"the question is too long")
        else:
            self._reply(200, "application/json", _answered(answer, self.rfile.read(int(length))))

    def _is_invited(self) -> bool:
        """Of this machine by name, and with the token: a foreign page of the browser can have neither."""
        local = self.headers.get("Host", "").rsplit(":", 1)[0] in _LOCAL
        given = self.path.split("/")[1:2]
        return local and secrets.compare_digest("".join(given).encode(), self.server.token.encode())

    def _wanted(self) -> str:
        return "/" + self.path.split("?")[0].split("/", 2)[-1] if self.path.count("/") > 1 else ""

    def _reply(self, status: int, kind: str, body: bytes) -> None:
        self.close_connection = True
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Referrer-Policy", "no-referrer")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are not worth a line each."""


def mapping_of(given: Any, what: str) -> Mapping[str, Any]:
    """An object of a question. Raises InputError for anything else."""
    if not isinstance(given, dict):
        raise InputError(f"{what} must be an object, not {given!r}.")
    return given


def numbers_of(given: Any, what: str, count: int | None = None) -> list[float]:
    """Numbers of a question, as many as asked for. Raises InputError for anything else."""
    good = isinstance(given, list) and len(given) <= _MOST and count in (None, len(given))
    if not good or not all(isinstance(v, (int, float)) and abs(v) < _GREATEST for v in given):
        raise InputError(f"{what} must be {'' if count is None else f'{count} '}finite number{'s' * (count != 1)}.")
    return [float(v) for v in given]


def page_server(page: str, answers: Mapping[str, Answer] | None = None, port: int = 0) -> PageServer:
    """A server on 127.0.0.1 that gives `page` at its `url` and answers POSTs below it; call ``serve_forever``.

    What goes wrong in an answer goes to the page as ``{"error": sentence}``. Port 0 takes a free one. Raises InputError
    for a port that cannot be had.
    """
    try:
        return PageServer(page, answers or {}, port)
    except (OSError, OverflowError) as error:
        raise InputError(f"port {port} cannot be used ({error}); give another with --port.") from error


def _answered(answer: Answer, body: bytes) -> bytes:
    try:
        question = parsed_json(body, "the question")
        if not isinstance(question, dict):
            raise InputError("the question must be a JSON object.")
        return json.dumps(answer(question), allow_nan=False).encode()
    except InputError as error:
        reason = str(error)
    except Exception as error:  # whatever an answer stumbles over, the page and its work go on
        reason = f"this could not be answered ({type(error).__name__}); try something else."
    return json.dumps({"error": reason}).encode()
