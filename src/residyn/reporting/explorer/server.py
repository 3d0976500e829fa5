"""The page, live, on this machine only.

What a browser shows from elsewhere must neither read this server nor drive it: it listens on the
loopback address; its pages lie under a random token; the Host of every request must be its own (a
foreign name that points here is refused), and the Origin, where there is one, too; what changes
something must have one. A content security policy lets the page load its own files and nothing
else.
"""

import secrets
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.base import BaseHTTPMiddleware, RequestResponseEndpoint
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp

from ...errors import InputError
from ...recordings.experiment import Experiment
from . import page
from .files import ExperimentFiles
from .hidden import hide_one
from .payload import packed, searched
from .study import Study
from .workbench import How, Workbench, Worker

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "Content-Security-Policy": POLICY,
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_LONGEST = 100_000  # bytes of a request
_STUDIES = 6  # kept at a time
T = TypeVar("T")
_KINDS = {".js": "text/javascript", ".css": "text/css", ".txt": "text/plain"}


class Explorer:
    """What the server holds: studies by number, 0 being the one that it was started with."""

    def __init__(
        self,
        experiment: Experiment,
        effects: tuple[str, ...] = (),
        name: str = "experiment.toml",
        files: ExperimentFiles | None = None,
        token: str | None = None,
    ):
        """`name` of the experiment on a command line; `files`: where it was read from."""
        self.token, self.name, self.effects = token or secrets.token_urlsafe(24), name, effects
        newest: dict[str, int] = {}
        self.worker, self.quick_worker = Worker(newest), Worker(newest)
        self.studies = {0: Workbench(experiment, effects, name, files)}
        self.random = np.random.default_rng()

    def app(self, port: int) -> Starlette:
        base = f"/{self.token}"
        routes = [
            Route(f"{base}/", self._page),
            Route(f"{base}/static/{{name}}", self._static),
            Route(f"{base}/api/{{study:int}}/state", self._state),
            Route(f"{base}/api/{{study:int}}/payload", self._payload),
            Route(f"{base}/api/{{study:int}}/searched", self._searched),
            Route(f"{base}/api/{{study:int}}/fit", self._fit, methods=["POST"]),
            Route(f"{base}/api/{{study:int}}/reload", self._reload, methods=["POST"]),
            Route(f"{base}/api/{{study:int}}/hide", self._hide, methods=["POST"]),
            Route(f"{base}/api/{{study:int}}/reveal", self._reveal, methods=["POST"]),
        ]
        guard = Middleware(Guard, port=port)
        return Starlette(
            routes=routes, middleware=[guard], exception_handlers={HTTPException: _gone}
        )

    def stop(self) -> None:
        for each in self.studies.values():
            each.stop()

    # -- answers ------------------------------------------------------------------------------

    async def _page(self, request: Request) -> Response:
        return Response(page.live(self.name), media_type="text/html")

    async def _static(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name not in page.FILES:
            return PlainTextResponse("no such file", 404)
        return Response(page.static(name), media_type=_KINDS[Path(name).suffix])

    def _bench(self, request: Request) -> Workbench:
        return _there(self.studies.get(request.path_params["study"]))

    def _study(self, request: Request) -> tuple[Workbench, Study]:
        bench = self._bench(request)
        return bench, _there(bench.study)

    async def _state(self, request: Request) -> Response:
        bench = self._bench(request)
        if seen := request.query_params.get("seen"):
            bench.look(seen)
        return JSONResponse(bench.state())

    async def _payload(self, request: Request) -> Response:
        return Response(_there(self._bench(request).text), media_type="application/json")

    async def _searched(self, request: Request) -> Response:
        _, study = self._study(request)
        words = request.query_params.get("since", "").split(",")
        since = [int(x) for x in words] if all(map(str.isdigit, words)) else []
        since = (*since, 0, 0)[:2]
        return JSONResponse(await self.worker.do(lambda: packed(searched(study, since))))

    async def _fit(self, request: Request) -> Response:
        bench, study = self._study(request)
        asked = await _asked(request)
        try:
            window, number, how = str(asked["window"]), int(asked["number"]), How(asked["how"])
            added = [str(x) for x in asked["added"]]
            held = {str(k): float(v) for k, v in asked.get("held", {}).items()}
        except (KeyError, TypeError, ValueError, AttributeError):
            return JSONResponse({"error": "a fit needs window, number, added and how"}, 400)
        worker = self.quick_worker if how is How.SMOOTHED else self.worker

        def work() -> dict[str, Any]:
            go_on = lambda words: worker.go_on(window, number)  # noqa: E731
            return packed(bench.fit(study, added, held, how, go_on))

        found = await worker.newest(window, number, work)
        return JSONResponse({"superseded": True} if found is None else found)

    async def _reload(self, request: Request) -> Response:
        known = _there(self._bench(request).files)
        asked, new = await _asked(request), known.new()
        added = (*known.added, *(str(x) for x in asked.get("add", []) if str(x) in new))
        try:
            files = await self.worker.do(lambda: ExperimentFiles(known.path, added, known.before))
        except InputError as error:
            return JSONResponse({"error": str(error)})
        return self._begun(Workbench(files.experiment, self.effects, self.name, files))

    async def _hide(self, request: Request) -> Response:
        _, study = self._study(request)
        try:
            made, effect = await self.worker.do(lambda: hide_one(study, self.random))
        except ValueError as error:
            return JSONResponse({"error": str(error)})
        return self._begun(Workbench(made, (), "simulated.toml", hidden=effect.label))

    async def _reveal(self, request: Request) -> Response:
        return JSONResponse({"hidden": _there(self._bench(request).hidden)})

    def _begun(self, bench: Workbench) -> Response:
        number = max(self.studies) + 1
        self.studies[number] = bench
        for old in sorted(self.studies)[1:-_STUDIES]:
            self.studies.pop(old).stop()
        return JSONResponse({"study": number})


def _there(x: T | None) -> T:
    if x is None:
        raise HTTPException(404, "there is no such study (any more): load the page again")
    return x


def _gone(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return JSONResponse({"error": error.detail}, error.status_code)


async def _asked(request: Request) -> dict[str, Any]:
    try:
        found = await request.json()
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


class Guard(BaseHTTPMiddleware):
    """Refuses requests that are not from this server's own page, and says what pages may do."""

    def __init__(self, app: ASGIApp, port: int):
        super().__init__(app)
        self.hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}

    async def dispatch(self, request: Request, call_next: RequestResponseEndpoint) -> Response:
        refused = self._refused(request.method, request.headers)
        found = await call_next(request) if refused is None else PlainTextResponse(refused, 403)
        found.headers.update(_HEADERS)
        return found

    def _refused(self, method: str, headers: Mapping[str, str]) -> str | None:
        host, origin = headers.get("host", ""), headers.get("origin")
        if host not in self.hosts:
            return "wrong host"
        if origin is not None and origin != f"http://{host}":
            return "wrong origin"
        if headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
            return "asked from another site"
        if method not in ("GET", "HEAD"):
            if origin is None:
                return "no origin"
            if not headers.get("content-type", "").startswith("application/json"):
                return "not JSON"
            size = headers.get("content-length", "")
            if not size.isdigit() or int(size) > _LONGEST:
                return "too long"
        return None


def serve(explorer: Explorer, port: int, opened: Callable[[str], None]) -> None:
    """Serve until Ctrl-C; `opened` is called with the address once the port is taken.

    **Arguments:** `port`: 0 takes one that is free.

    **Raises:** `InputError` if the port cannot be had.
    """
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind(("127.0.0.1", port))
    except (OSError, OverflowError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(
            f"--port {port}: cannot be had ({why}); --port 0 takes one that is free"
        ) from None
    port = listening.getsockname()[1]
    config = uvicorn.Config(
        explorer.app(port), log_level="warning", lifespan="off", server_header=False,
        timeout_graceful_shutdown=1,
    )  # fmt: skip
    listening.listen()
    opened(f"http://127.0.0.1:{port}/{explorer.token}/")
    try:
        uvicorn.Server(config).run(sockets=[listening])
    except KeyboardInterrupt:
        pass
    finally:
        explorer.stop()
        listening.close()
