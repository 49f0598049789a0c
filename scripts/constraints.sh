#!/usr/bin/env bash
# Writes constraints.txt, the exact versions of all dependencies, from a temporary environment with
# all extras. Run it with `make constraints`.
set -euo pipefail
cd "$(dirname "$0")/.."

python=${1:-python3}
# Only torch is pinned by hand: its newest version is not available everywhere as a CPU build.
torch=torch==2.13.0

work=$(mktemp -d)
trap 'rm -rf "$work" constraints.txt.new' EXIT
"$python" -m venv "$work/venv"
pip=("$work/venv/bin/python" -m pip --disable-pip-version-check)
extras=$("$work/venv/bin/python" -c '
import tomllib
with open("pyproject.toml", "rb") as file:
    print(",".join(tomllib.load(file)["project"]["optional-dependencies"]))')

echo "installing PackIt-Sim with [$extras] into $work/venv (takes some minutes)"
"${pip[@]}" install --quiet --quiet "$torch"
"${pip[@]}" install --quiet --quiet --upgrade setuptools ".[$extras]"
{
    version=$("$work/venv/bin/python" -c 'import platform; print(platform.python_version())')
    echo "# Made by \`make constraints\` with Python $version on $(uname -sm)."
    # Local version labels (+cpu) name a build of the same release.
    "${pip[@]}" freeze --all --exclude packit-sim --exclude pip | sed 's/+[A-Za-z0-9.]*$//'
} > constraints.txt.new
if grep -vE '^(#.*|[A-Za-z0-9._-]+==[A-Za-z0-9.!]+)$' constraints.txt.new; then
    echo "the lines above are not of the form NAME==VERSION: constraints.txt is unchanged" >&2
    exit 1
fi
mv constraints.txt.new constraints.txt
echo "wrote constraints.txt: $(grep -c == constraints.txt) pins"
