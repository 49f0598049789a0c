#!/usr/bin/env bash
# Creates .venv with PackIt-Sim and extras, or adds extras to it: `make setup EXTRAS=dev`. Without
# extras it is the base installation. If it fails, no half-made .venv is left.
set -euo pipefail
cd "$(dirname "$0")/.."

python=${1:-python3} extras=${2:-} venv=.venv

fail() {
    echo "$*" >&2
    exit 1
}

version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2> /dev/null) ||
    fail "$python does not run: install Python 3.11 to 3.14, or name one: make PYTHON=/path/to/python"
case $version in
    3.11 | 3.12 | 3.13 | 3.14) ;;
    *) fail "$python is Python $version, PackIt-Sim needs 3.11 to 3.14: make PYTHON=/path/to/python" ;;
esac
"$python" -c 'import ensurepip, venv' 2> /dev/null ||
    fail "$python has no venv: on Debian and Ubuntu, apt install python$version-venv"

case ,$extras, in
    ,,) size="0.6 GB" ;;
    *,dev,* | *,learn,* | *,all,* | *,bench,*)
        size="2.5 GB with a CPU build of torch, 6 GB with a CUDA build" ;;
    *) size="about 1 GB" ;;
esac
echo "installing PackIt-Sim${extras:+ with the extras $extras} into $venv: $size"
if [ "$version" != 3.11 ]; then
    case ,$extras, in
        *,dev,* | *,physics,* | *,all,*)
            echo "PyBullet has no wheel for Python $version: compiling it takes about 12 minutes" ;;
    esac
fi

progress() { # one line for each step of pip, and a count of the packages found
    awk -v tty="$([ -t 1 ] && echo 1)" '
        /^ *Collecting / { n++; if (tty) printf "\r  found %d packages", n; fflush() }
        /^Installing collected/ { printf "%s  installing %d packages\n", tty ? "\r" : "", NF - 3; fflush() }'
}

if [ ! -e $venv ]; then
    trap '[ $? -eq 0 ] || rm -rf $venv' EXIT
    trap 'exit 130' INT TERM
    "$python" -m venv $venv
fi
$venv/bin/python -m pip --disable-pip-version-check install --progress-bar off \
    --constraint constraints.txt --editable ".${extras:+[$extras]}" | progress
bash scripts/slim-pybullet.sh $venv
echo "$venv is ready"
