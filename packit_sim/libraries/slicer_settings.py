"""Settings files of slicers in 3MF: names of objects, and volumes that are no solids."""

from __future__ import annotations

from dataclasses import dataclass
from zipfile import ZipFile

from lxml import etree

FILES = ("Metadata/Slic3r_PE_model.config", "Metadata/model_settings.config")
"""Settings files of PrusaSlicer, and of Bambu Studio and OrcaSlicer."""

_NEGATIVE = ("NegativeVolume", "negative_part")

_NO_SOLID = (
    *("ParameterModifier", "SupportBlocker", "SupportEnforcer"),
    *("modifier_part", "support_blocker", "support_enforcer"),
)


@dataclass(frozen=True)
class ObjectSettings:
    """A slicer's settings of an object.

    Attributes
    ----------
    name : str
        Its name, or "".
    components : frozenset of int
        Numbers of components that are no solids, such as modifiers and support blockers.
    triangles : tuple of slice
        Triangles of its mesh that belong to such volumes.
    negative : int
        The number of volumes that the slicer cuts out of the others.
    """

    name: str = ""
    components: frozenset[int] = frozenset()
    triangles: tuple[slice, ...] = ()
    negative: int = 0


def read_settings(archive: ZipFile) -> dict[int, ObjectSettings]:
    """Read the settings of each object in the root model, by its number."""
    found = {}
    for file in FILES:
        if file in archive.namelist():
            for element in etree.fromstring(archive.read(file)).iterchildren("object"):
                found[int(element.get("id", 0))] = _settings(element)
    return found


def _settings(element: etree._Element) -> ObjectSettings:
    components, triangles, negative = set(), [], 0
    for volume in element.iterchildren("volume", "part"):
        kind = volume.get("subtype") or _value(volume, "volume_type") or "ModelPart"
        if _value(volume, "modifier") == "1" and kind == "ModelPart":  # before PrusaSlicer 2
            kind = "ParameterModifier"
        negative += kind in _NEGATIVE
        if kind not in _NO_SOLID:
            continue
        if volume.tag == "part":
            components.add(int(volume.get("id", 0)))
        else:
            triangles.append(slice(int(volume.get("firstid")), int(volume.get("lastid")) + 1))
    name = _value(element, "name") or ""
    return ObjectSettings(name, frozenset(components), tuple(triangles), negative)


def _value(element: etree._Element, key: str) -> str | None:
    """Return a setting of an object or a volume."""
    for each in element.iterchildren("metadata"):
        if each.get("key") == key:
            return str(each.get("value", ""))
    return None
