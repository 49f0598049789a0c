#!/usr/bin/env bash
# Removes from an environment what PyBullet's wheel has and PackIt-Sim never uses: the debug symbols of
# its library (126 MB) and the robots and scenes of its examples (133 MB), apart from the panda.
#
#     scripts/slim-pybullet.sh .venv
set -euo pipefail

for packages in "$1"/lib/python3*/site-packages; do
    rm -rf "$packages/pybullet_envs"
    if [ -d "$packages/pybullet_data" ]; then
        find "$packages/pybullet_data" -mindepth 1 -maxdepth 1 ! -name __init__.py ! -name franka_panda \
            -exec rm -rf {} +
    fi
    for library in "$packages"/pybullet.*.so; do
        if [ -e "$library" ] && command -v strip > /dev/null; then
            strip --strip-debug -o "$library.slim" "$library"
            mv "$library.slim" "$library" # a process that has it loaded keeps the old file
        fi
    done
done
