"""Run the campaigns of the trust pages anew, one after the other: a night on two cores.

python -m campaigns                  # all of them
python -m campaigns packings mutants
python -m campaigns --list           # the code that has changed since each was run
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter

from campaigns.common import ROOT
from campaigns.night import CAMPAIGNS, changed, read_stamps, run


def main() -> None:
    """Run the campaigns, or list what has changed."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="campaign", help=", ".join(CAMPAIGNS))
    parser.add_argument("--list", action="store_true", help="only list what has changed")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(CAMPAIGNS):
        parser.error(f"no campaign {sorted(unknown)[0]!r}: choose from {', '.join(CAMPAIGNS)}")
    if arguments.list:
        for name, stamp in read_stamps().items():
            print(f"{name}, {stamp.day}: {', '.join(changed(name, stamp)) or 'nothing'} changed")
    elif failed := run(arguments.names or list(CAMPAIGNS), ROOT / "build" / "campaigns"):
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
