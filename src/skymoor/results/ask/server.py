# SPDX-License-Identifier: Apache-2.0
"""The page on this machine: asks until somebody answers. Its address has a random token, which every request needs."""

from __future__ import annotations

import secrets
import threading
import webbrowser
from collections.abc import Callable, Mapping, Sequence
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs

from skymoor.errors import InputError
from skymoor.pipeline.prior import Person
from skymoor.results.ask.answer import Statement, person_of
from skymoor.results.ask.page import AskPage
from skymoor.results.ask.question import Question
from skymoor.results.read import Result

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")
LARGEST_BODY, MOST_FIELDS, WAIT_S = 20_000, 50, 30.0
GROUPS = {
    "area": ("west", "south", "east", "north"),
    "near": ("lat", "lon", "radius"),
    "point": ("u", "v", "lat", "lon"),
    "length": ("u0", "v0", "u1", "v1", "m"),
}
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class AskServer:
    """Serves the page until an answer came; use it as a context manager."""

    def __init__(self, result: Result, questions: Sequence[Question], port: int = 0, by: str = "") -> None:
        """Raises `InputError` for a port that is none, or taken."""
        if not 0 <= port < 65536:
            raise InputError(f"--port {port}: give a whole number from 0 to 65535")
        self.by = by
        self.token = secrets.token_urlsafe(16)
        self.answer: Person | None = None
        self._result, self._questions = result, {one.name: one for one in questions}
        self._page = AskPage(result, list(questions))
        self._answered, self._lock = threading.Event(), threading.Lock()
        try:
            self._server = ThreadingHTTPServer((HOST, port), _handler(self))
        except OSError as error:
            raise InputError(f"--port {port}: {error.strerror}; give another, or none") from error
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)

    def __enter__(self) -> AskServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._server.server_address[1])

    @property
    def address(self) -> str:
        """Of the page, with its token."""
        return f"http://{HOST}:{self.port}/{self.token}/"

    def wait(self) -> Person:
        """The answer, once there is one."""
        while not self._answered.wait(1.0):  # in steps, so that Ctrl+C is heard
            pass
        assert self.answer is not None
        return self.answer

    def page(self) -> bytes:
        """The question."""
        return self._page.asking()

    def answered(self, form: Mapping[str, str]) -> tuple[HTTPStatus, bytes]:
        """Status and page after an answer; the first that makes sense counts."""
        try:
            question = self._questions.get(form.get("component", ""))
            if question is None:
                raise InputError(f"there is no question about component {form.get('component', '')!r}")
            person = person_of(
                self._result, question, statement_of({**form, "by": form.get("by", "").strip() or self.by})
            )
        except InputError as error:
            return HTTPStatus.BAD_REQUEST, self._page.asking(str(error))
        with self._lock:
            self.answer = self.answer or person
        return HTTPStatus.OK, self._page.thanking(f"Recorded: {person.record['words']}")

    def finish(self) -> None:
        """Let `wait` return, after the page of thanks was sent."""
        if self.answer is not None:
            self._answered.set()


def statement_of(form: Mapping[str, str]) -> Statement:
    """What the fields of the page state. Raises `InputError` for one that is no number or lacks its others."""
    candidate = form.get("candidate", "")
    if candidate and not candidate.isdecimal():
        raise InputError(f"candidate {candidate!r}: give a number")
    groups = {name: _group(form, name, parts) for name, parts in GROUPS.items()}
    return Statement(
        candidate=int(candidate) if candidate else None,
        heading=form.get("heading", "").strip() or None,
        north=_number(form, "north"),
        height=_number(form, "height"),
        by=form.get("by", "")[:100],
        **groups,
    )


def _group(form: Mapping[str, str], name: str, parts: Sequence[str]) -> tuple[float, ...] | None:
    values = [_number(form, f"{name}_{part}") for part in parts]
    given = [value for value in values if value is not None]
    if given and len(given) < len(parts):
        raise InputError(f"{name}: fill in all of {', '.join(parts)}")
    return tuple(given) or None


def _number(form: Mapping[str, str], name: str) -> float | None:
    text = form.get(name, "").strip()
    if not text:
        return None
    try:
        return float(text.replace(",", "."))
    except ValueError:
        raise InputError(f"{name.replace('_', ' ')} {text[:40]!r}: give a number") from None


def _handler(server: AskServer) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        server_version, sys_version, timeout = "skymoor", "", WAIT_S

        def do_GET(self) -> None:
            if self._is_ours("/"):
                self._send(HTTPStatus.OK, server.page())

        def do_POST(self) -> None:
            if not self._is_ours("/answer"):
                return
            size = self.headers.get("Content-Length", "")
            if not size.isdecimal() or int(size) > LARGEST_BODY:
                self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "the answer is too large")
                return
            try:
                body = self.rfile.read(int(size)).decode()
                form = parse_qs(body, keep_blank_values=True, max_num_fields=MOST_FIELDS)
            except ValueError:
                self._refuse(HTTPStatus.BAD_REQUEST, "the answer cannot be read")
                return
            self._send(*server.answered({name: values[-1] for name, values in form.items()}))
            server.finish()

        def _is_ours(self, path: str) -> bool:
            """Whether a request is for this page by its own name; else it is refused.

            A page of the web may send requests here under a name of its own, and does not know the token.
            """
            host = self.headers.get("Host", "")
            if host not in [f"{name}:{server.port}" for name in NAMES]:
                self._refuse(HTTPStatus.FORBIDDEN, "this page is served to this machine alone")
            elif not secrets.compare_digest(self.path.encode(), f"/{server.token}{path}".encode()):
                self._refuse(HTTPStatus.NOT_FOUND, "use the address that skymoor ask printed")
            else:
                return True
            return False

        def _refuse(self, status: HTTPStatus, text: str) -> None:
            self.close_connection = True
            self._send(status, text.encode(), "text/plain")

        def _send(self, status: HTTPStatus, body: bytes, kind: str = "text/html") -> None:
            self.send_response(status)
            for name, value in HEADERS.items():
                self.send_header(name, value)
            self.send_header("Content-Type", f"{kind}; charset=utf-8")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            pass

    return Handler


def ask_in_browser(
    result: Result, questions: Sequence[Question], *, port: int, browser: bool, by: str, note: Callable[[str], None]
) -> Person:
    """Show the page until somebody answered it; `by` is who, where the page does not say."""
    with AskServer(result, questions, port, by) as server:
        note(f"{server.address}: answer there; stop with Ctrl+C")
        if browser:
            webbrowser.open(server.address)
        return server.wait()
