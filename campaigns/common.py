"""What campaigns share: their results files, and the tables of these in the documentation."""

from __future__ import annotations

import json
from argparse import ArgumentParser
from pathlib import Path
from typing import Any

from benchmarks import common

ROOT = Path(__file__).parents[1]

RESULTS = Path(__file__).parent / "results"

PAGES = ROOT / "docs" / "trust"


def argument_parser(description: str | None) -> ArgumentParser:
    """Create a parser with --seed, --out and --table, whose help is a module docstring."""
    parser = common.argument_parser(description)
    parser.set_defaults(out=RESULTS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--table", action="store_true", help="only write the table of the results into its page"
    )
    return parser


def read_results(name: str, folder: Path = RESULTS) -> dict[str, Any]:
    """Read the results of a campaign; an empty dict if there are none."""
    file = folder / f"{name}.json"
    return json.loads(file.read_text()) if file.exists() else {}


def table_in_page(name: str) -> str:
    """Return what a campaign's page has between the comments around its results."""
    return common.table_in_page(PAGES / f"{name}.md")


def write_into_page(name: str, table: str) -> None:
    """Write the results of a campaign between these comments of its page."""
    common.write_into_page(PAGES / f"{name}.md", table)
