"""ShapeNetCore as a source of shapes: versions 1 and 2, OBJ or GLB."""

from __future__ import annotations

import hashlib
from functools import partial
from pathlib import Path

from msgspec import Struct

from packit_sim.core import typed_json
from packit_sim.core.caches import cached_property
from packit_sim.core.errors import LibraryError
from packit_sim.core.files import read_whole
from packit_sim.libraries import mesh_files, splits
from packit_sim.libraries.raw_meshes import RawMesh
from packit_sim.libraries.sources import Candidate, Source

TAXONOMY = "taxonomy.json"

FILES = (
    "models/model_normalized.obj",
    "models/model_normalized.glb",
    "models/model.obj",
    "models/model.glb",
    "model.obj",
    "model.glb",
)
"""Possible mesh files in a model's folder: version 2 first, then version 1."""

CATEGORIES = {
    "02691156": "airplane",
    "02747177": "trash-bin",
    "02773838": "bag",
    "02801938": "basket",
    "02808440": "bathtub",
    "02818832": "bed",
    "02828884": "bench",
    "02834778": "bicycle",
    "02843684": "birdhouse",
    "02858304": "boat",
    "02871439": "bookshelf",
    "02876657": "bottle",
    "02880940": "bowl",
    "02924116": "bus",
    "02933112": "cabinet",
    "02942699": "camera",
    "02946921": "can",
    "02954340": "cap",
    "02958343": "car",
    "02992529": "cellphone",
    "03001627": "chair",
    "03046257": "clock",
    "03085013": "keyboard",
    "03207941": "dishwasher",
    "03211117": "display",
    "03261776": "earphone",
    "03325088": "faucet",
    "03337140": "file-cabinet",
    "03467517": "guitar",
    "03513137": "helmet",
    "03593526": "jar",
    "03624134": "knife",
    "03636649": "lamp",
    "03642806": "laptop",
    "03691459": "loudspeaker",
    "03710193": "mailbox",
    "03759954": "microphone",
    "03761084": "microwave",
    "03790512": "motorcycle",
    "03797390": "mug",
    "03928116": "piano",
    "03938244": "pillow",
    "03948459": "pistol",
    "03991062": "flowerpot",
    "04004475": "printer",
    "04074963": "remote",
    "04090263": "rifle",
    "04099429": "rocket",
    "04225987": "skateboard",
    "04256520": "sofa",
    "04330267": "stove",
    "04379243": "table",
    "04401088": "telephone",
    "04460130": "tower",
    "04468005": "train",
    "04530566": "watercraft",
    "04554684": "washer",
}
"""Our name for each synset of ShapeNetCore; `taxonomy.json` names any other."""


class _Synset(Struct):
    """An entry of the taxonomy."""

    synsetId: str
    name: str


class ShapeNet(Source):
    """A folder of synset folders of models, as ShapeNetCore is distributed (Chang et al., 2015).

    Ids are `category/model`. A model in two synsets is one object, one group. Models without a mesh
    file are `missing`. The digest is of ids and file sizes, because hashing 51,000 files takes too
    long.

    Parameters
    ----------
    seed : int, default: 0
        The seed of the splits.

    Raises
    ------
    LibraryError
        If the folder has no models, or its taxonomy can't be read.
    """

    def __init__(self, folder: Path, seed: int = 0) -> None:
        names = _names(folder / TAXONOMY)
        self._files: dict[str, Path] = {}
        categories: dict[str, str] = {}
        missing: dict[str, str] = {}
        synsets = [path for path in sorted(folder.iterdir()) if _is_synset(path)]
        for synset in synsets:
            category = CATEGORIES.get(synset.name) or names.get(synset.name, synset.name)
            for model in sorted(synset.iterdir()):
                id = f"{category}/{model.stem}"
                file = _mesh_file(model)
                if file is not None:
                    self._files[id] = file
                    categories[id] = category
                elif model.is_dir():
                    missing[id] = f"{model}: holds none of {', '.join(FILES)}"
        if not categories:
            raise LibraryError(
                f"{folder}: not laid out as ShapeNetCore is: it holds {len(synsets)} synset "
                "folders (eight digits, as 02691156) and no model with a mesh file in them"
            )
        super().__init__(folder, "shapenet", "", categories, missing, seed)

    @property
    def locator(self) -> str:
        return f"shapenet:{self.path}"

    @cached_property
    def digest(self) -> str:
        sha = hashlib.sha256()
        for id, file in sorted(self._files.items()):
            sha.update(f"{id} {file.stat().st_size}\n".encode())
        return sha.hexdigest()

    @cached_property
    def splits(self) -> dict[str, tuple[str, ...]]:
        """The paper's three subsets: 100 shapes of each category, or a third of it."""
        groups = {id: _model(id) for id in self.categories}
        return splits.divide(self.categories, groups, self.seed)

    def candidate(self, id: str) -> Candidate:
        file = self._files[id]
        return Candidate(
            id,
            self.categories[id],
            partial(_read, file),
            title=_model(id),
            licence="LicenseRef-ShapeNet",
            source=str(file),
            group=_model(id),
        )


def _model(id: str) -> str:
    """Return the name of a model, the same for one object in two synsets."""
    return id.rpartition("/")[2]


def _read(file: Path) -> RawMesh:
    """Read a model's mesh: y up in any format, and of unknown size."""
    return RawMesh(mesh_files.read(file).mesh, up="y")


def _is_synset(path: Path) -> bool:
    return len(path.name) == 8 and path.name.isdigit() and path.is_dir()


def _mesh_file(model: Path) -> Path | None:
    """Return the mesh file of a model's folder, or the model itself if it is a mesh file."""
    if model.suffix.lower() in (".glb", ".obj") and model.is_file():
        return model
    found = (model / name for name in FILES)
    return next((file for file in found if file.is_file()), None)


def _names(taxonomy: Path) -> dict[str, str]:
    """Read the first name of each synset, with hyphens for spaces, if there is a taxonomy."""
    if not taxonomy.exists():
        return {}
    try:
        synsets = typed_json.decode(read_whole(taxonomy), list[_Synset], LibraryError, "it")
    except (OSError, LibraryError) as error:
        raise LibraryError(f"{taxonomy}: can't be read as ShapeNet's taxonomy: {error}") from None
    return {one.synsetId: one.name.split(",")[0].strip().replace(" ", "-") for one in synsets}
