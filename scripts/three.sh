#!/usr/bin/env bash
# Builds assets/three: the part of three.js that the report's page includes, as one script. Needs npm.
set -euo pipefail

root=$(cd "$(dirname "$0")/.." && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

cd "$work"
npm install --silent --no-audit --no-fund three@0.187.0 esbuild@0.28.2
cp "$root/scripts/three.js" entry.js
npx esbuild entry.js --bundle --minify --target=es2020 --format=iife --global-name=THREE \
    --legal-comments=inline --log-level=warning --outfile=three.min.js
mkdir -p "$root/assets/three"
cp three.min.js "$root/assets/three/three.min.js"
cp node_modules/three/LICENSE "$root/assets/three/LICENSE"
