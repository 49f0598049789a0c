"""The workbench: a page's parts, the search that packs them, and the results."""

from __future__ import annotations

import itertools
import shutil
import tempfile
import threading
import time
import zipfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from http import HTTPStatus
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, BinaryIO, cast

from msgspec import Meta, Struct

from packit_sim.core import typed_json
from packit_sim.core.errors import ArgumentError, PackItError, message
from packit_sim.core.length_units import check_unit
from packit_sim.core.plain_text import plain_logger
from packit_sim.core.temporary_folders import TemporaryFolder
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.filling.task_checks import check_ways
from packit_sim.parts.reading.named_containers import named_containers
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.sizes import lengths_text
from packit_sim.parts.results.exports import export
from packit_sim.parts.workbench.jobs import PackingJob, ReadJob, checked_job, read_job
from packit_sim.parts.workbench.moving import MAX_MOVES, Move, MovedParts
from packit_sim.parts.workbench.page_state import PageState, ShownPacking
from packit_sim.parts.workbench.preview import preview
from packit_sim.parts.workbench.repacking import repacked
from packit_sim.parts.workbench.uploads import MAX_BYTES, Uploads
from packit_sim.web.http_server import (
    HttpRoute,
    HttpServer,
    RequestError,
    WebAnswer,
    WebRequest,
)
from packit_sim.web.origins import LOOPBACK
from packit_sim.web.page_models import page_files

ARCHIVE = "packing.zip"
"""The name of all files of a result as one."""

_MAX_JSON = 2**20

_CHUNK = 2**20

MAX_CONFLICTS = 100
"""Most conflicts of moved parts that an answer has, the first ones."""

_CHECKING = "checking the result"

_TYPES = {
    ".3mf": "model/3mf",
    ".glb": "model/gltf-binary",
    ".stl": "model/stl",
    ".json": "application/json",
    ".png": "image/png",
    ".html": "text/html; charset=utf-8",
}
"""Media types of the files of a packing."""

_log = plain_logger(__name__)


class _Files(Struct, forbid_unknown_fields=True):
    instructions: bool = False


class _Number(Struct, forbid_unknown_fields=True):
    number: int


class _Lock(Struct, forbid_unknown_fields=True):
    part: int
    locked: bool


class _FileUnit(Struct, forbid_unknown_fields=True):
    number: int
    unit: str


class _Moves(Struct, forbid_unknown_fields=True):
    packing: str
    moves: Annotated[list[Move], Meta(max_length=MAX_MOVES)]
    box: int = 0
    accept: bool = False


class Workbench:
    """A local web page to pack parts: send files, set the box, pack, lock parts, pack the rest.

    Each search continues from the packing that is shown, so that no worse one follows it. Results
    can be undone.

    Close it, or use it in a `with` statement. Nothing of it stays: the files that were sent and
    the results are in a temporary folder.

    Parameters
    ----------
    host : str
        Where the page listens, see `HttpServer`.
    port : int, optional
        The same.

    Attributes
    ----------
    address : str
        The page's URL for a browser on this machine.
    folder : Path
        The temporary folder.

    Raises
    ------
    RenderError
        If the page can't be served.
    """

    def __init__(self, host: str = LOOPBACK, port: int | None = None) -> None:
        self._folder = TemporaryFolder("packit-workbench-")
        self.folder = self._folder.path
        (self.folder / "parts").mkdir()
        self._uploads = Uploads(self.folder / "parts")
        self._page = PageState()
        self._results = itertools.count(1)
        self._search: threading.Thread | None = None
        self._stop = threading.Event()
        self._checking = threading.Lock()  # one order or packing at a time: meshes need memory
        try:
            self._server = HttpServer(self._routes(), host, port)
        except BaseException:
            self._folder.remove()
            raise
        self.address = self._server.address

    def close(self) -> None:
        """End the page and its search, and remove its folder; calling it again does nothing."""
        if not self._folder.remove.alive:
            return
        self._server.close()
        self._stop.set()
        if self._search is not None:
            self._search.join()
        self._folder.remove()

    def __enter__(self) -> Workbench:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def _routes(self) -> dict[tuple[str, str], HttpRoute]:
        here = Path(__file__).parent
        shared = page_files()
        script, style = "text/javascript; charset=utf-8", "text/css; charset=utf-8"
        fixed = {
            "/": (here / "page.html", "text/html; charset=utf-8"),
            **{f"/{file.name}": (file, script) for file in (here / "scripts").glob("*.js")},
            "/page.css": (here / "page.css", style),
            "/pages.css": (shared["style"], style),
            "/box_scene.js": (shared["scene"], script),
            "/three.js": (shared["three"], script),
        }
        found = {("GET", path): HttpRoute(_file(*file)) for path, file in fixed.items()}
        return found | {
            ("GET", "/state"): HttpRoute(self._state),
            ("GET", "/files/"): HttpRoute(self._download),
            ("GET", f"/{ARCHIVE}"): HttpRoute(self._archive),
            ("POST", "/parts"): HttpRoute(self._upload, MAX_BYTES),
            ("POST", "/remove"): HttpRoute(self._remove, _MAX_JSON),
            ("POST", "/unit"): HttpRoute(self._set_unit, _MAX_JSON),
            ("POST", "/order"): HttpRoute(self._keep_order, _MAX_JSON),
            ("POST", "/lock"): HttpRoute(self._lock, _MAX_JSON),
            ("POST", "/moves"): HttpRoute(self._move_parts, _MAX_JSON),
            ("GET", "/containers"): HttpRoute(self._containers),
            ("POST", "/pack"): HttpRoute(self._pack, _MAX_JSON),
            ("POST", "/stop"): HttpRoute(self._end),
            ("POST", "/undo"): HttpRoute(lambda _: self._move(-1)),
            ("POST", "/redo"): HttpRoute(lambda _: self._move(1)),
            ("POST", "/write"): HttpRoute(self._write, _MAX_JSON),
        }

    def _upload(self, request: WebRequest) -> WebAnswer:
        name, unit = request.query.get("name", ""), check_unit(request.query.get("unit", "mm"))
        try:
            upload = self._uploads.add(name, request.body, unit)
        except ArgumentError as error:
            raise RequestError(str(error), HTTPStatus.UNPROCESSABLE_ENTITY) from None
        self._page.note()
        return WebAnswer.of_json({"number": upload.number})

    def _remove(self, request: WebRequest) -> WebAnswer:
        self._uploads.remove(_read(request, _Number).number)
        self._page.note()
        return WebAnswer.of_json({})

    def _set_unit(self, request: WebRequest) -> WebAnswer:
        asked = _read(request, _FileUnit)
        self._uploads.read_in(asked.number, check_unit(asked.unit))
        self._page.note()
        return WebAnswer.of_json({})

    def _keep_order(self, request: WebRequest) -> WebAnswer:
        """Keep the order as it is on the page; return its faults, and its preview."""
        job = _read(request, PackingJob)
        self._page.order = typed_json.builtins(job)
        with self._checking:
            return WebAnswer.of_json(self._checked(job))

    def _checked(self, job: PackingJob) -> dict[str, Any]:
        """Return the faults of an order, and its preview as far as there is one."""
        uploads = dict(self._uploads.files)
        checked = checked_job(job, uploads)
        answer: dict[str, Any] = {"faults": checked.faults}
        if checked.read is not None:
            shapes = {
                part.name: shape
                for each in uploads.values()
                for part, shape in zip(each.parts, each.shapes, strict=True)
            }
            settings = checked.read.settings
            obstacles = cast(list[Part], [*settings.fixed, *settings.keep_out])
            ordered, in_place = (
                [(part, shapes[part.name]) for part in own]
                for own in (checked.read.parts, obstacles)
            )
            assert settings.unit is not None
            answer |= preview(checked.boxes[0], settings.unit, ordered, in_place)
        return answer

    def _containers(self, request: WebRequest) -> WebAnswer:
        """Return the containers that have a name."""
        known = named_containers().values()
        return WebAnswer.of_json([[one.name, f"{one.kind}, {one.size}"] for one in known])

    def _move_parts(self, request: WebRequest) -> WebAnswer:
        """Return the conflicts of parts that are moved by hand, or begin to accept their places."""
        asked = _read(request, _Moves)
        shown = self._page.result(asked.packing)
        moved = MovedParts.of(shown.packed, asked.box, asked.moves)
        if asked.accept:
            return self._begun(lambda: self._start(self._accept, shown.key, moved), _CHECKING)
        with self._checking:
            found = list(islice(moved.conflicts(), MAX_CONFLICTS))
        return WebAnswer.of_json({"conflicts": [each.to_json() for each in found]})

    def _lock(self, request: WebRequest) -> WebAnswer:
        asked = _read(request, _Lock)
        self._page.lock(asked.part, asked.locked)
        return WebAnswer.of_json({})

    def _move(self, steps: int) -> WebAnswer:
        if not self._page.move(steps):
            raise RequestError("there is no such result, or a search is running")
        return WebAnswer.of_json({})

    def _pack(self, request: WebRequest) -> WebAnswer:
        job = _read(request, PackingJob)
        self._page.order = typed_json.builtins(job)
        return self._begun(lambda: self._begin(job), "preparing the parts")

    def _write(self, request: WebRequest) -> WebAnswer:
        instructions = _read(request, _Files).instructions
        shown = self._page.shown
        if shown is None:
            raise RequestError("there is no packing yet: press Pack")
        return self._begun(lambda: self._start(self._export, shown, instructions), _CHECKING)

    def _begun(self, begin: Callable[[], None], message: str) -> WebAnswer:
        """Begin work on the packing, unless there is some already."""
        if not self._page.begin(message):
            raise RequestError("a search is running: stop it first", HTTPStatus.CONFLICT)
        try:
            begin()
        except BaseException as error:
            fault = error if isinstance(error, ArgumentError) else None
            self._page.end(f"error: {error}", fault=fault)
            raise
        return WebAnswer.of_json({})

    def _end(self, request: WebRequest) -> WebAnswer:
        self._stop.set()
        return WebAnswer.of_json({})

    def _begin(self, job: PackingJob) -> None:
        """Start the search of a job, which keeps the files that it needs."""
        self._stop = threading.Event()
        kept = ExitStack()
        with ExitStack() as failed:
            failed.push(kept)
            files = kept.enter_context(self._uploads.kept(set(job.numbers)))
            read = read_job(job, {each.number: each for each in files}, stop=self._stop)
            if not read.parts:
                what = "each count is 0" if job.files else "there are no parts: send mesh files"
                raise ArgumentError(what)
            self._start(self._run, job, read, self._page.shown, kept)
            failed.pop_all()

    def _start(self, work: Callable[..., None], *arguments: Any) -> None:
        """Begin work in a separate thread."""
        self._search = threading.Thread(target=self._attempt, args=(work, arguments), daemon=True)
        self._search.start()

    def _attempt(self, work: Callable[..., None], arguments: tuple[Any, ...]) -> None:
        """Do work, and say on the page why it failed, if it did."""
        try:
            work(*arguments)
        except (PackItError, OSError) as error:
            fault = error if isinstance(error, ArgumentError) else None
            self._page.end(f"error: {message(error)}", fault=fault)
        except Exception as error:
            _log.exception("the work failed")
            self._page.end(f"unexpected error: {error}")

    def _run(
        self,
        job: PackingJob,
        read: ReadJob,
        before: ShownPacking | None,
        kept: ExitStack,
    ) -> None:
        """Search, and then let go of the files that were sent."""
        start = time.perf_counter()

        def show_step(step: str, done: int, total: int) -> None:
            self._page.note(f"{step} the parts" + (f", {done} of {total}" if total else ""))

        def better(packed: PackedParts, locked: tuple[int, ...]) -> None:
            seconds = time.perf_counter() - start
            self._page.note(
                f"{packed.packed_of_asked}, density {packed.density:.3f}, after {seconds:.0f} s",
                ShownPacking(packed, locked),
            )

        with kept:
            task = prepared_task(read.parts, read.box, job.objective, read.settings, show_step)
            check_ways(task, job.instructions, film=False)
            end = max(start + job.seconds, time.perf_counter() + job.seconds / 3)
            earlier, locked = (None, ()) if before is None else (before.packed, before.locked)
            packed, locked = repacked(task, earlier, locked, end, better)
            if not packed.packings:
                raise ArgumentError(f"nothing is packed: {packed.left_out[0].reason}")
            shown = ShownPacking(packed, locked)
            self._page.note(shown=shown)
            self._export(shown, job.instructions, before, time.perf_counter() - start)

    def _accept(self, key: str, moved: MovedParts) -> None:
        """Make a packing of which parts were moved a new result, in which they are locked."""
        before = self._page.shown
        if before is None or before.key != key:
            raise ArgumentError("the packing has changed meanwhile: look at it again")

        def show_step(step: str, done: int, total: int) -> None:
            self._page.note(f"{step}, {done} of {total}")

        packed, stay = moved.accepted(before.locked, show_step)
        result = ShownPacking(packed, stay if before.can_lock else ())
        count = len(moved.numbers)
        what = f"done: {count} part{'s' * (count > 1)} moved" + " and locked" * before.can_lock
        self._page.end(what, result)

    def _export(
        self,
        shown: ShownPacking,
        instructions: bool,
        before: ShownPacking | None = None,
        seconds: float | None = None,
    ) -> None:
        """Check a packing and write its files; it is a new result if a search has found it."""
        out = self.folder / f"packing-{next(self._results)}"

        def show_step(step: str, done: int, total: int) -> None:
            self._page.note(step + (f", {done} of {total}" if total > 1 else ""))

        try:
            files = export(shown.packed, out, show_step, instructions=instructions)
        except BaseException:
            shutil.rmtree(out, ignore_errors=True)
            raise
        own = {file.name: file for file in files if file.parent == out}
        text = "done: the files are written" if seconds is None else _done(shown, before, seconds)
        self._page.end(text, replace(shown, folder=out, files=own), seconds is not None)

    def _state(self, request: WebRequest) -> WebAnswer:
        """Return all that the page shows, unless it has seen it."""
        seen, packing = request.query.get("seen"), request.query.get("packing")
        return WebAnswer.of_json(self._page.to_json(seen, packing, self._files))

    def _files(self) -> list[dict[str, Any]]:
        """Return what the page shows of the files that were sent."""
        return [
            {
                "number": each.number,
                "name": each.file.name,
                "unit": each.unit,
                "own unit": each.has_own_unit,
                "parts": sum(part.count for part in each.parts),
                "size": " and ".join(
                    f"{lengths_text(part.mesh.extents)} {part.unit}" for part in each.parts[:2]
                ),
            }
            for each in list(self._uploads.files.values())
        ]

    def _archive(self, request: WebRequest) -> WebAnswer:
        """Return all files of the result as one."""
        files = self._page.all_opened()
        if not files:
            raise RequestError("there are no files yet", HTTPStatus.NOT_FOUND)
        with ExitStack() as opened:
            for file in files.values():
                opened.enter_context(file)
            # The server closes it.
            whole = cast(BinaryIO, tempfile.TemporaryFile(dir=self.folder))  # noqa: SIM115
            with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
                for name, file in files.items():
                    with archive.open(name, "w", force_zip64=True) as member:
                        shutil.copyfileobj(file, member, _CHUNK)
        header = {"Content-Disposition": f'attachment; filename="{ARCHIVE}"'}
        return WebAnswer(whole, "application/zip", header)

    def _download(self, request: WebRequest) -> WebAnswer:
        file = self._page.opened(request.path)
        if file is None:
            raise RequestError(f"there is no file {request.path}", HTTPStatus.NOT_FOUND)
        name = {"Content-Disposition": f'attachment; filename="{request.path}"'}
        return WebAnswer(file, _TYPES[Path(request.path).suffix], name)


def _done(shown: ShownPacking, before: ShownPacking | None, seconds: float) -> str:
    """Return what a search has changed."""
    packed = shown.packed
    text = f"done in {seconds:.0f} s: {packed.packed_of_asked}, density {packed.density:.3f}"
    if before is None:
        return text
    if before.packed.task.digest != packed.task.digest:
        return f"{text}; before, with another order, {before.packed.packed_of_asked}"
    more = packed.count - before.packed.count
    if more:
        return f"{text}; {abs(more)} part{'s' * (abs(more) > 1)} {'more' if more > 0 else 'fewer'}"
    return f"{text}; " + (
        "better than before" if packed.score > before.packed.score else "nothing better was found"
    )


def _file(file: Path, kind: str) -> Any:
    return lambda request: WebAnswer(file.open("rb"), kind)


def _read(request: WebRequest, kind: type[Any]) -> Any:
    return typed_json.decode(request.body.read(), kind, RequestError, "the request")
