"""The workbench: a page's parts, the search that packs them, and the results."""

from __future__ import annotations

import itertools
import shutil
import tempfile
import threading
import time
import zipfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any, BinaryIO, cast

from msgspec import Meta, Struct

from packit_sim.core import typed_json
from packit_sim.core.choices import Goal
from packit_sim.core.errors import ArgumentError, PackItError, message
from packit_sim.core.plain_text import plain_logger
from packit_sim.core.temporary_folders import TemporaryFolder
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.filling.task import PackSettings
from packit_sim.parts.reading.boxes import MeshBox, box_types
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.sizes import lengths_text
from packit_sim.parts.reading.units import check_unit, lengths
from packit_sim.parts.results.exports import export
from packit_sim.parts.workbench.page_state import PageState, ShownPacking
from packit_sim.parts.workbench.preview import preview
from packit_sim.parts.workbench.repacking import repacked
from packit_sim.parts.workbench.uploads import MAX_BYTES, MAX_FILES, Upload, Uploads
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


class _Asked(Struct, forbid_unknown_fields=True):
    """A file's parts to pack: how many of them, and their rotations."""

    number: int
    count: Annotated[int, Meta(ge=0)]
    rotations: str


class PackingJob(Struct, forbid_unknown_fields=True):
    """A job of packing, as the page sends it."""

    box: str
    unit: str
    files: Annotated[list[_Asked], Meta(max_length=MAX_FILES)]
    objective: Goal = "volume"
    clearance: str = "0"
    wall_clearance: str = "0"
    seconds: Annotated[float, Meta(gt=0, le=86400)] = 60.0
    seed: Annotated[int, Meta(ge=0)] = 0
    instructions: bool = False


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
            "/page.js": (here / "page.js", script),
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
        """Keep the order as it is on the page; return its preview, or why there is none."""
        job = _read(request, PackingJob)
        self._page.order = typed_json.builtins(job)
        try:
            unit = check_unit(job.unit)
            _refuse_files(job.box)
            box = box_types(job.box, unit, 1)[0]
            asked = {each.number: each.count for each in job.files}
            ordered = [
                (part, shape, asked.get(each.number, 1) * part.count)
                for each in list(self._uploads.files.values())
                for part, shape in zip(each.parts, each.shapes, strict=True)
            ]
            return WebAnswer.of_json(preview(box, unit, ordered))
        except PackItError as error:
            return WebAnswer.of_json({"fault": str(error)})

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
            self._page.end(f"error: {error}")
            raise
        return WebAnswer.of_json({})

    def _end(self, request: WebRequest) -> WebAnswer:
        self._stop.set()
        return WebAnswer.of_json({})

    def _begin(self, job: PackingJob) -> None:
        """Start the search of a job, which keeps the files that it needs."""
        _refuse_files(job.box)
        self._stop = threading.Event()
        uploads = ExitStack()
        with ExitStack() as failed:
            failed.push(uploads)
            numbers = [asked.number for asked in job.files]
            parts = _parts(job, uploads.enter_context(self._uploads.kept(numbers)))
            settings = PackSettings(
                clearance=_length(job.clearance, job.unit),
                wall_clearance=_length(job.wall_clearance, job.unit),
                unit=check_unit(job.unit),
                stop=self._stop,
            )
            self._start(self._run, job, parts, settings, self._page.shown, uploads)
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
            self._page.end(f"error: {message(error)}")
        except Exception as error:
            _log.exception("the work failed")
            self._page.end(f"unexpected error: {error}")

    def _run(
        self,
        job: PackingJob,
        parts: list[Part],
        settings: PackSettings,
        before: ShownPacking | None,
        uploads: ExitStack,
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

        with uploads:
            task = prepared_task(parts, job.box, job.objective, settings, show_step)
            task.check_ways(job.instructions, film=False)
            end = max(start + job.seconds, time.perf_counter() + job.seconds / 3)
            earlier, locked = (None, ()) if before is None else (before.packed, before.locked)
            packed, locked = repacked(task, earlier, locked, end, better)
            if not packed.packings:
                raise ArgumentError(f"nothing is packed: {packed.left_out[0].reason}")
            shown = ShownPacking(packed, locked)
            self._page.note(shown=shown)
            self._export(shown, job.instructions, before, time.perf_counter() - start)

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
        files = [
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
        seen, packing = request.query.get("seen"), request.query.get("packing")
        return WebAnswer.of_json(self._page.to_json(seen, packing, files))

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


def _parts(job: PackingJob, files: Sequence[Upload]) -> list[Part]:
    """Return the parts of a job."""
    found = [
        replace(part, count=asked.count * part.count, rotations=asked.rotations)
        for asked, upload in zip(job.files, files, strict=True)
        for part in upload.parts
        if asked.count > 0
    ]
    if not found:
        what = "each count is 0" if job.files else "there are no parts: send mesh files"
        raise ArgumentError(what)
    return found


def _refuse_files(box: str) -> None:
    """Raise ArgumentError if a box is a file of this machine, which others may not see."""
    if MeshBox.parse(box) is not None:
        raise ArgumentError(
            f"box {box!r:.80} is a file: choose sides, such as 300x200x150mm or "
            "cylinder:220x300mm; packit pack takes meshes"
        )


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


def _length(text: str, unit: str) -> float:
    return lengths(text, 1, check_unit(unit))[0]
