"""Croissant metadata of archives: JSON-LD by which tools find, check and load a dataset.

The vocabularies are Croissant 1.0 and its Responsible AI extension, both of MLCommons.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from packit_sim.core.version import DOCUMENTATION

_TERMS = (
    *("citeAs", "column", "equivalentProperty", "extract", "field", "fileObject", "fileProperty"),
    *("fileSet", "format", "includes", "isLiveDataset", "jsonPath", "key", "md5", "parentField"),
    *("path", "recordSet", "references", "regex", "repeated", "replace", "samplingRate"),
    *("separator", "source", "subField", "transform"),
)

_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    **{name: f"cr:{name}" for name in _TERMS},
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "sc": "https://schema.org/",
}

ENCODINGS = {
    ".jsonl": "application/jsonlines",
    ".json": "application/json",
    ".npz": "application/zip",
    ".md": "text/markdown",
    ".png": "image/png",
}
"""Encoding formats by the suffix of a file."""


@dataclass(frozen=True)
class Records:
    """A table that a loader reads from one file.

    Attributes
    ----------
    name : str
        The name of the table.
    file : str
        The file of the archive.
    types : Mapping of str to str
        The type of each field, such as "sc:Float".
    json_path : str
        The records within a JSON file, such as "$.shapes[*]"; by default each line is one.
    """

    name: str
    file: str
    types: Mapping[str, str]
    json_path: str = ""

    def to_json(self) -> dict[str, Any]:
        """Write the record set."""
        return {
            "@type": "cr:RecordSet",
            "@id": self.name,
            "name": self.name,
            "field": [
                {
                    "@type": "cr:Field",
                    "@id": f"{self.name}/{name}",
                    "name": name,
                    "dataType": kind,
                    "source": {
                        "fileObject": {"@id": self.file},
                        "extract": (
                            {"jsonPath": f"{self.json_path}.{name}"}
                            if self.json_path
                            else {"column": name}
                        ),
                    },
                }
                for name, kind in self.types.items()
            ],
        }


@dataclass(frozen=True)
class Metadata:
    """Description of the data of an archive.

    Attributes
    ----------
    version : str
        The version of PackIt-Sim, and the first characters of the digest.
    date : str
        When it is published, as YYYY-MM-DD.
    licences : tuple of str
        SPDX identifiers, the most frequent first.
    responsible_ai : Mapping
        Texts by the names of the Responsible AI vocabulary, such as "dataBiases".
    files : Mapping of str to bytes
        The data, by paths in the archive.
    """

    name: str
    title: str
    summary: str
    author: str
    version: str
    date: str
    licences: tuple[str, ...]
    keywords: tuple[str, ...]
    responsible_ai: Mapping[str, str | Sequence[str]]
    records: tuple[Records, ...]
    files: Mapping[str, bytes] = field(repr=False)

    def with_file(self, name: str, data: bytes) -> Metadata:
        """Return the metadata with another file."""
        return replace(self, files={**self.files, name: data})

    @property
    def citation(self) -> str:
        """The entry for BibTeX."""
        return (
            f"@misc{{{self.name.replace('-', '_')}, author = {{{{{self.author}}}}}, "
            f"title = {{{self.title}}}, version = {{{self.version}}}, year = {{{self.date[:4]}}}, "
            f"url = {{{DOCUMENTATION}}}}}"
        )


def croissant(metadata: Metadata) -> dict[str, Any]:
    """Write metadata as Croissant's JSON-LD.

    Parameters
    ----------
    metadata : Metadata
        The metadata.

    Returns
    -------
    dict
        The content of `croissant.json`, which `mlcroissant` validates.
    """
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": [
            "http://mlcommons.org/croissant/1.0",
            "http://mlcommons.org/croissant/RAI/1.0",
        ],
        "name": metadata.name,
        "description": metadata.summary,
        "version": metadata.version,
        "datePublished": metadata.date,
        "license": [f"https://spdx.org/licenses/{name}.html" for name in metadata.licences],
        "creator": {"@type": "sc:Organization", "name": metadata.author},
        "publisher": {"@type": "sc:Organization", "name": metadata.author},
        "url": DOCUMENTATION,
        "citeAs": metadata.citation,
        "keywords": metadata.keywords,
        "isLiveDataset": False,
        **{f"rai:{name}": text for name, text in metadata.responsible_ai.items()},
        "distribution": [
            {
                "@type": "cr:FileObject",
                "@id": name,
                "name": name,
                "contentUrl": name,
                "contentSize": f"{len(data)} B",
                "encodingFormat": ENCODINGS[name[name.rindex(".") :]],
                "sha256": hashlib.sha256(data).hexdigest(),
            }
            for name, data in metadata.files.items()
        ],
        "recordSet": [records.to_json() for records in metadata.records],
    }
