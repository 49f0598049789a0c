"""The workbench: a page's parts, the search that packs them, and the results."""

from __future__ import annotations

import itertools
import shutil
import threading
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any

import trimesh
from msgspec import Meta, Struct

from packit_sim.core import typed_json
from packit_sim.core.choices import Goal
from packit_sim.core.errors import ArgumentError, PackItError, message
from packit_sim.core.plain_text import plain_logger
from packit_sim.core.temporary_folders import TemporaryFolder
from packit_sim.geometry.motions import split
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.task import PackSettings
from packit_sim.parts.pack import pack
from packit_sim.parts.reading.boxes import MeshBox
from packit_sim.parts.reading.files import ReadSettings, find_parts
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.sizes import lengths_text
from packit_sim.parts.reading.units import check_unit, lengths
from packit_sim.parts.results.exports import export
from packit_sim.parts.workbench.page_state import LockedPart, PageState, ShownPacking
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

_MAX_JSON = 2**20

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
    locked: list[int] = []
    instructions: bool = False


class _Number(Struct, forbid_unknown_fields=True):
    number: int


class Workbench:
    """A local web page to pack parts: send files, set the box, pack, lock parts, pack the rest.

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
            ("POST", "/parts"): HttpRoute(self._upload, MAX_BYTES),
            ("POST", "/remove"): HttpRoute(self._remove, _MAX_JSON),
            ("POST", "/pack"): HttpRoute(self._pack, _MAX_JSON),
            ("POST", "/stop"): HttpRoute(self._end),
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

    def _pack(self, request: WebRequest) -> WebAnswer:
        job = _read(request, PackingJob)
        if not self._page.begin():
            raise RequestError("a search is running: stop it first", HTTPStatus.CONFLICT)
        try:
            self._begin(job)
        except BaseException as error:
            self._page.end(f"error: {error}")
            raise
        return WebAnswer.of_json({})

    def _end(self, request: WebRequest) -> WebAnswer:
        self._stop.set()
        return WebAnswer.of_json({})

    def _begin(self, job: PackingJob) -> None:
        """Start the search of a job, which keeps the files that it needs."""
        if MeshBox.parse(job.box) is not None:  # of this machine, which others may not see
            raise ArgumentError(
                f"box {job.box!r:.80} is a file: choose sides, such as 300x200x150mm or "
                "cylinder:220x300mm; packit pack takes meshes"
            )
        self._stop = threading.Event()
        locked = self._locked_parts(job.locked)
        uploads = ExitStack()
        with ExitStack() as failed:
            failed.push(uploads)
            numbers = [asked.number for asked in job.files]
            files = uploads.enter_context(self._uploads.kept(numbers))
            parts = _parts(job, files, Counter(each.name for each in locked))
            settings = PackSettings(
                clearance=_length(job.clearance, job.unit),
                wall_clearance=_length(job.wall_clearance, job.unit),
                unit=check_unit(job.unit),
                reading=ReadSettings(check_unit(job.unit)),
                fixed=[each.part for each in locked],
                stop=self._stop,
            )
            self._search = threading.Thread(
                target=self._run, args=(job, parts, settings, locked, uploads), daemon=True
            )
            self._search.start()
            failed.pop_all()

    def _locked_parts(self, numbers: list[int]) -> tuple[LockedPart, ...]:
        """Return the parts of the last packing that stay, by their numbers in its one box."""
        shown = self._page.shown
        if not numbers:
            return ()
        if shown is None or len(shown.packed.packings) != 1:
            raise ArgumentError("there is no packing in one box whose parts can be locked")
        packed, locked = shown.packed, shown.locked
        placements = packed.contents[0].placements
        found = []
        for n in sorted(set(numbers)):
            if not 0 <= n < len(placements):
                raise ArgumentError(f"there is no part {n} to lock")
            part, pose = packed.part(placements[n]).part, packed.pose(placements[n])
            linear, place = split(pose)
            vertices = part.mesh.vertices @ linear.T + place
            mesh = trimesh.Trimesh(vertices, part.mesh.faces, process=False)
            name = locked[n].name if n < len(locked) else part.name
            fixed = Part(name, mesh, unit=packed.task.unit, mass=part.mass, density=part.density)
            found.append(LockedPart(name, fixed))
        return tuple(found)

    def _run(
        self,
        job: PackingJob,
        parts: list[Part],
        settings: PackSettings,
        locked: tuple[LockedPart, ...],
        uploads: ExitStack,
    ) -> None:
        """Search, in a separate thread, and then let go of the files that were sent."""
        out = self.folder / f"packing-{next(self._results)}"
        total = sum(part.count for part in parts)

        def better(packed: PackedParts, seconds: float) -> None:
            self._page.note(
                f"{packed.count} of {total} parts, density {packed.density:.3f}, "
                f"after {seconds:.0f} s",
                ShownPacking(packed, locked),
            )

        try:
            with uploads:
                packed = pack(
                    parts,
                    job.box,
                    job.objective,
                    job.seconds,
                    job.seed,
                    callback=better,
                    settings=settings,
                )
                if not packed.packings:
                    raise ArgumentError(f"nothing is packed: {packed.left_out[0].reason}")
                shown = ShownPacking(packed, locked)
                self._page.note("checking the result and writing its files", shown)
                files = export(packed, out, instructions=job.instructions)
        except Exception as error:
            shutil.rmtree(out, ignore_errors=True)
            if isinstance(error, (PackItError, OSError)):
                self._page.end(f"error: {message(error)}")
            else:
                _log.exception("the search failed")
                self._page.end(f"unexpected error: {error}")
        else:
            own = {file.name: file for file in files if file.parent == out}
            self._page.end("", replace(shown, folder=out, files=own))

    def _state(self, request: WebRequest) -> WebAnswer:
        """Return all that the page shows, unless it has seen it."""
        files = [
            {
                "number": each.number,
                "name": each.file.name,
                "unit": each.unit,
                "parts": sum(part.count for part in each.parts),
                "size": " and ".join(
                    f"{lengths_text(part.mesh.extents)} {part.unit}" for part in each.parts[:2]
                ),
            }
            for each in list(self._uploads.files.values())
        ]
        return WebAnswer.of_json(self._page.to_json(request.query.get("seen"), files))

    def _download(self, request: WebRequest) -> WebAnswer:
        file = self._page.opened(request.path)
        if file is None:
            raise RequestError(f"there is no file {request.path}", HTTPStatus.NOT_FOUND)
        name = {"Content-Disposition": f'attachment; filename="{request.path}"'}
        return WebAnswer(file, _TYPES[Path(request.path).suffix], name)


def _parts(job: PackingJob, files: Sequence[Upload], locked: Counter[str]) -> list[Part]:
    """Return the parts of a job, less those that are locked."""
    found = []
    for asked, upload in zip(job.files, files, strict=True):
        parts = upload.parts
        if upload.unit != job.unit:
            parts = find_parts([upload.file], ReadSettings(check_unit(job.unit))).parts
        for part, known in zip(parts, upload.parts, strict=True):
            count = asked.count * part.count - locked[known.name]
            if count > 0:
                own = replace(part, name=known.name, count=count, rotations=asked.rotations)
                found.append(own)
    if not found:
        what = "all parts are locked" if job.files else "there are no parts: send mesh files"
        raise ArgumentError(what)
    return found


def _file(file: Path, kind: str) -> Any:
    return lambda request: WebAnswer(file.open("rb"), kind)


def _read(request: WebRequest, kind: type[Any]) -> Any:
    return typed_json.decode(request.body.read(), kind, RequestError, "the request")


def _length(text: str, unit: str) -> float:
    return lengths(text, 1, check_unit(unit))[0]
