#!/usr/bin/env bash
# Installs a wheel as a stranger would, in an empty folder with an empty home, without a compiler, and
# tries the main commands; prints a transcript with times and sizes.
#
#     scripts/try-install.sh dist/packit_sim-0.1.0-py3-none-any.whl python3.13
#     scripts/try-install.sh dist/packit_sim-0.1.0-py3-none-any.whl python3.11 learn,view,report
set -euo pipefail

wheel=$(realpath "$1") python=$2 extras=${3:-}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir "$work/home" "$work/empty"
cd "$work/empty"

clean=(env -i HOME="$work/home" PATH="$work/venv/bin:/usr/bin:/bin" CC=/bin/false CXX=/bin/false)
for name in PIP_CERT PIP_CONSTRAINT PIP_EXTRA_INDEX_URL PIP_FIND_LINKS SSL_CERT_FILE; do # if set
    if [ -n "${!name:-}" ]; then clean+=("$name=${!name}"); fi
done

try() { # a command line, its last lines of output, and its time
    local started=$SECONDS
    echo "\$ $1"
    "${clean[@]}" bash -c "$1" > "$work/output" 2>&1 || { tail -20 "$work/output"; echo "FAILED"; exit 1; }
    tail -"${2:-1}" "$work/output"
    echo "# $((SECONDS - started)) s"
}

"$python" --version
"$python" -m venv "$work/venv"
try "pip install --quiet --disable-pip-version-check '$wheel${extras:+[$extras]}'"
echo "# $(du -sm "$work/venv" | cut -f1) MB"
try "packit --version"
try "packit export starter --out parts.3mf --unit-mm 300"
try "packit pack parts.3mf --box 300x300x300mm --time 20s --out packed"
try "packit verify packed/packing.json"
try "packit demo" 3
try "packit evaluate starter --tasks 5 --agent largest-first/aligned/blbf --out results.jsonl" 11
try "packit verify results.jsonl"
try "packit render demo --out again.png"
case ,$extras, in *,report,*) try "packit report results.jsonl --out report.html" ;; esac
case ,$extras, in *,learn,*)
    try "packit train --out training --set steps=512"
    try "packit evaluate starter --tasks 5 --agent packnn/aligned/blbf" 3
    ;;
esac
case ,$extras, in *,view,*)
    try "(timeout 60 packit view results.jsonl --port 8123 > view.txt 2>&1 & sleep 45; python -c 'import urllib.request as u; print(len(u.urlopen(\"http://127.0.0.1:8123\").read()) > 1000)'; wait) || true"
    ;;
esac
