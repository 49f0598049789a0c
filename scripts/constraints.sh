#!/usr/bin/env bash
# Writes constraints.txt: the exact version of everything that PackIt-Sim can install, from a
# throw-away environment with all extras in it. Say `make constraints`.
set -euo pipefail
cd "$(dirname "$0")/.."

python=${1:-python3}
# Only torch is chosen by hand: its newest is not everywhere to be had as a build for the CPU.
torch=torch==2.13.0

work=$(mktemp -d)
trap 'rm -rf "$work" constraints.txt.new' EXIT
"$python" -m venv "$work/venv"
pip=("$work/venv/bin/python" -m pip --disable-pip-version-check)
extras=$("$work/venv/bin/python" -c '
import tomllib
with open("pyproject.toml", "rb") as file:
    print(",".join(tomllib.load(file)["project"]["optional-dependencies"]))')

echo "installing PackIt-Sim with [$extras] into $work/venv: some minutes"
"${pip[@]}" install --quiet --quiet "$torch"
"${pip[@]}" install --quiet --quiet --upgrade setuptools ".[$extras]"
{
    version=$("$work/venv/bin/python" -c 'import platform; print(platform.python_version())')
    echo "# Made by \`make constraints\` with Python $version on $(uname -sm)."
    # Local version labels (+cpu) name a build of the same release.
    "${pip[@]}" freeze --all --exclude packit-sim --exclude pip | sed 's/+[A-Za-z0-9.]*$//'
} > constraints.txt.new
if grep -vE '^(#.*|[A-Za-z0-9._-]+==[A-Za-z0-9.!]+)$' constraints.txt.new; then
    echo "the lines above are no plain pins: constraints.txt is left as it was" >&2
    exit 1
fi
mv constraints.txt.new constraints.txt
echo "wrote constraints.txt: $(grep -c == constraints.txt) pins"
