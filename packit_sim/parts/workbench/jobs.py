"""Jobs: orders of the page, read into parts, boxes and settings by the readers of `packit pack`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

from msgspec import NODEFAULT, Meta, Struct, structs

from packit_sim.core.choices import Door, Goal, GroupRule, LoadingOrder
from packit_sim.core.errors import ArgumentError, about
from packit_sim.core.length_units import check_unit
from packit_sim.parts.filling.preparation import prepared_boxes
from packit_sim.parts.filling.setting_texts import read_settings
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.handling.constraints import Constraints
from packit_sim.parts.packings.bounds import COUNTS
from packit_sim.parts.packings.turning import Turning
from packit_sim.parts.reading.box_lists import is_list
from packit_sim.parts.reading.boxes import BoxType, MeshBox
from packit_sim.parts.reading.files import own_length
from packit_sim.parts.reading.manifest import part_fields
from packit_sim.parts.reading.named_containers import without_names
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.turnings import read_turning
from packit_sim.parts.workbench.uploads import MAX_FILES, Upload

MAX_BOXES = 50
"""Most sizes of boxes of a job."""

Field = Literal[
    "value",
    "priority",
    "mass",
    "density",
    "no_stack",
    "max_load",
    "clearance",
    "group",
    "max_tilt",
    "down",
    "stop",
]
"""Fields of a manifest that a file of the page may have."""

Texts = Annotated[list[str], Meta(max_length=MAX_BOXES)]


class AskedFile(Struct, forbid_unknown_fields=True):
    """A file of the page, and its use.

    Attributes
    ----------
    count : int or str
        How many of each part, "max" or "fill".
    use : str
        Whether its parts are packed, or are in the box, in its coordinates.
    fields : dict of str to str
        Further fields of a manifest.
    """

    number: int
    count: Annotated[int, Meta(ge=0)] | Literal["max", "fill"] = 1
    rotations: str = "cube"
    use: Literal["part", "keep_out", "fixed"] = "part"
    fields: dict[Field, str] = {}

    def parts(self, upload: Upload, turning: Turning) -> list[Part]:
        """Return the parts of its file, as a manifest would describe them, with usual limits."""
        with about(f"file {self.number}"):
            count, more = {"count": self.count, "rotations": self.rotations}, self.fields
            fields = part_fields({**count, **{name: text for name, text in more.items() if text}})
            clearance = fields.pop("clearance", None)
            limits = {name: fields.pop(name) for name in ("max_tilt", "down") if name in fields}
            fields["turning"] = replace(turning, **limits)
            found = []
            for part in upload.parts:
                own = dict(fields)
                own["count"] = min(part.count * own["count"], int(COUNTS.high) + 1)
                if own.get("as_many_as_fit"):
                    own["count"] = int(COUNTS.high)
                if clearance is not None:
                    own["clearance"] = own_length(clearance, part.unit, part.unit_cm)
                found.append(replace(part, **own))
            return found


class AskedBox(Struct, forbid_unknown_fields=True):
    """A box or another container.

    Attributes
    ----------
    size : str
        Its sides, or what `--container` takes, without a file.
    file : int, optional
        The number of the file that is its mesh, instead of a size.
    count : int, optional
        How many there are.
    """

    size: str = ""
    file: int | None = None
    name: str = ""
    count: int | None = None

    @property
    def text(self) -> str:
        """The box as `packit pack` takes it."""
        name = f"{self.name}:" if self.name else ""
        return f"{name}{self.size}" + (f"={self.count}" if self.count else "")


class PackingJob(Struct, forbid_unknown_fields=True):
    """A job of packing, as the page sends it: settings of `pack()` and `PackSettings` as text."""

    box: Annotated[list[AskedBox], Meta(min_length=1, max_length=MAX_BOXES)]
    unit: str
    files: Annotated[list[AskedFile], Meta(max_length=MAX_FILES)]
    objective: Goal = "volume"
    clearance: str = "0"
    clearance_z: str | None = None
    wall_clearance: str = "0"
    boxes: int | None = None
    removable: bool = False
    insertable: bool = False
    separable: bool = False
    door: Door = "z+"
    order: LoadingOrder | None = None
    max_tilt: str | None = None
    down: str | None = None
    stable: str | None = None
    max_mass: Texts = []
    max_parts: Texts = []
    balance: Texts = []
    even: bool = False
    powder: str | None = None
    groups: Annotated[list[GroupRule], Meta(max_length=MAX_BOXES)] = []
    seconds: Annotated[float, Meta(gt=0, le=86400)] = 60.0
    seed: Annotated[int, Meta(ge=0)] = 0
    instructions: bool = False

    @property
    def numbers(self) -> list[int]:
        """The numbers of the files that it needs."""
        asked = [each.number for each in self.files]
        return [*asked, *(each.file for each in self.box if each.file is not None)]


@dataclass(frozen=True)
class ReadJob:
    """A job that was read.

    Attributes
    ----------
    parts : tuple of Part
        The parts to pack.
    box : tuple of str or MeshBox
        The boxes.
    """

    parts: tuple[Part, ...]
    box: tuple[str | MeshBox, ...]
    settings: PackSettings

    def boxes(self, objective: Goal) -> tuple[BoxType, ...]:
        """Read and prepare the boxes; raise ArgumentError if they can't be used so."""
        with about("box"):
            box = without_names(self.box)[0]
        assert self.settings.unit is not None
        return prepared_boxes(box, objective, self.settings, self.settings.unit)[0]


def read_job(job: PackingJob, uploads: Mapping[int, Upload], **more: Any) -> ReadJob:
    """Read a job.

    Parameters
    ----------
    uploads : mapping of int to Upload
        The files by their numbers.
    **more : object
        Further settings of `PackSettings`.

    Returns
    -------
    ReadJob
        The parts, which may be none, the boxes and the settings.

    Raises
    ------
    ArgumentError
        If something is not possible; its `setting` is the name of the field, or "file N".
    """
    with about("unit"):
        unit = check_unit(job.unit)
    turning = read_turning(job.max_tilt, job.down)
    walls = {each.file for each in job.box}
    used: dict[str, list[Part]] = {"part": [], "keep_out": [], "fixed": []}
    for asked in job.files:
        if asked.number not in uploads:
            raise ArgumentError(f"there is no file {asked.number}")
        if asked.number in walls:
            continue
        if asked.use != "part":
            used[asked.use] += uploads[asked.number].parts
        elif asked.count != 0:
            used["part"] += asked.parts(uploads[asked.number], turning)
    with about("box"):
        texts = [each.text for each in job.box if each.file is None]
        for text in texts:
            _refuse_file(text)
        box = tuple(_read_box(each, job, uploads) for each in job.box)
    settings = read_settings(
        texts,
        unit,
        clearance=job.clearance,
        clearance_z=job.clearance_z,
        wall_clearance=job.wall_clearance,
        stable=job.stable,
        max_mass=job.max_mass,
        max_parts=job.max_parts,
        balance=job.balance,
        even=job.even,
        powder=job.powder,
        door=job.door,
        order=job.order,
        boxes=_checked_count(job.boxes),
        removable=job.removable,
        insertable=job.insertable,
        separable=job.separable,
        groups=job.groups,
        keep_out=used["keep_out"],
        fixed=used["fixed"],
        **more,
    )
    return ReadJob(tuple(used["part"]), box, settings)


@dataclass(frozen=True)
class CheckedJob:
    """The check of a job before its parts are prepared.

    Attributes
    ----------
    faults : dict of str to str
        The first fault of each setting, by its name.
    read : ReadJob, optional
        The job with default values instead of those that are not possible; None if that is not
        possible either.
    boxes : tuple of BoxType
        Its boxes.
    """

    faults: dict[str, str]
    read: ReadJob | None = None
    boxes: tuple[BoxType, ...] = ()


def checked_job(job: PackingJob, uploads: Mapping[int, Upload]) -> CheckedJob:
    """Check a job.

    Parameters
    ----------
    uploads : mapping of int to Upload
        The files by their numbers.

    Returns
    -------
    CheckedJob
        The job, and its faults.
    """
    found: dict[str, str] = {}
    defaults = {
        each.name: each.default if each.default_factory is NODEFAULT else each.default_factory()
        for each in structs.fields(PackingJob)
        if not each.required
    }
    while True:
        try:
            read = read_job(job, uploads)
            boxes = read.boxes(job.objective)
            _check_together(job, read, boxes)
            return CheckedJob(found, read, boxes)
        except ArgumentError as error:
            found.setdefault(error.setting, str(error))
            name, _, number = error.setting.partition(" ")
            if name == "file":
                own = [each for each in job.files if str(each.number) != number]
                job = structs.replace(job, files=own)
            elif name in defaults and getattr(job, name) != defaults[name]:
                job = structs.replace(job, **{name: defaults[name]})
            else:
                return CheckedJob(found)


def _check_together(job: PackingJob, read: ReadJob, boxes: Sequence[BoxType]) -> None:
    """Raise ArgumentError, in the words of the page, if settings do not go together."""
    parts, settings = read.parts, read.settings
    asked = Constraints(
        removable=settings.removable,
        insertable=settings.insertable,
        separable=settings.separable,
        door=settings.door,
        stable=settings.stable,
        masses=(),
    )
    for box in boxes:
        asked.check_container(box.container)
    if settings.even and (settings.order is not None or not asked.is_empty):
        with about("even"):
            raise ArgumentError(
                "even layers are not possible with rules: moved parts may break them"
            )
    if settings.fixed and (len(boxes) > 1 or boxes[0].count != 1):
        with about("box"):
            raise ArgumentError("fixed parts are in one box: choose a single one")
    if not parts:
        return
    if job.objective == "value" and all(part.value is None for part in parts):
        with about("objective"):
            raise ArgumentError("no part has a value: give it one under “more” below its name")
    if settings.groups and all(part.group is None for part in parts):
        with about("groups"):
            raise ArgumentError("no part has a group: name one under “more” below its name")
    unstopped = [part.name for part in parts if part.stop is None]
    if settings.order is not None and unstopped:
        with about("order"):
            raise ArgumentError(f"{unstopped[0]} has no stop: give it one under “more”")
    massless = [part.name for part in parts if part.mass is None and part.density is None]
    weighed = {
        "max_mass": any(box.limits.max_mass is not None for box in boxes),
        "balance": any(box.limits.balance is not None for box in boxes)
        and len(massless) < len(parts),
        "powder": settings.powder is not None,
    }
    for name, is_weighed in weighed.items():
        if massless and is_weighed:
            with about(name):
                raise ArgumentError(f"{massless[0]} has no mass: give it one under “more”")
    if any(part.as_many_as_fit for part in parts) and any(box.count is None for box in boxes):
        with about("boxes"):
            raise ArgumentError("to pack as many as fit, say how many boxes there are")


def _checked_count(count: int | None) -> int | None:
    with about("boxes"):
        return PackSettings(boxes=count).boxes


def _refuse_file(text: str) -> None:
    """Raise ArgumentError if a box is a file of this machine, which others may not see."""
    if MeshBox.parse(text) is not None or is_list(text):
        raise ArgumentError(
            f"box {text!r:.80} is a file of this machine: send it to the page, and choose it there"
        )


def _read_box(box: AskedBox, job: PackingJob, uploads: Mapping[int, Upload]) -> str | MeshBox:
    """Return a box as text, or the mesh of one with its number."""
    if box.file is None:
        return box.text
    if box.file not in uploads:
        raise ArgumentError(f"there is no file {box.file}: choose one that was sent")
    parts = uploads[box.file].parts
    name = box.name or parts[0].name
    if len(parts) > 1:
        raise ArgumentError(f"{name} has {len(parts)} parts: a container is one closed mesh")
    count = box.count or job.boxes or (None if job.objective == "boxes" else 1)
    return MeshBox(replace(parts[0], rotations="fixed"), name, count)
