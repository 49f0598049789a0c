#!/usr/bin/env bash
# Installs what PyBullet needs to draw with OpenGL without a screen, libEGL and a Mesa driver, and
# Chromium, in which the tests look at the viewer's page. Does nothing where all are there. Never
# fails: pictures then come from the software renderer, and those tests are skipped.
set -euo pipefail

have_egl() {
    PATH="$PATH:/sbin:/usr/sbin" ldconfig -p 2> /dev/null | grep 'libEGL\.so\.1 ' > /dev/null
}

have_driver() {
    compgen -G '/usr/lib*/dri/*_dri.so' ||
        compgen -G '/usr/lib/*/dri/*_dri.so' ||
        compgen -G '/usr/lib*/libgallium-*.so' ||
        compgen -G '/usr/lib/*/libgallium-*.so'
} > /dev/null

apt_install() {
    export DEBIAN_FRONTEND=noninteractive
    local options=(-qq -o Acquire::http::Timeout=30 -o DPkg::Lock::Timeout=120)
    apt-get "${options[@]}" update &&
        apt-get "${options[@]}" install -y --no-install-recommends "$@"
} < /dev/null > /dev/null 2>&1

have_chromium() {
    command -v chromium || command -v chromium-browser
} > /dev/null

missing=()
have_egl || missing+=(libegl1)
have_driver || missing+=(libgl1-mesa-dri)
have_chromium || missing+=(chromium)
if [ ${#missing[@]} -eq 0 ]; then
    exit 0
fi
if [ "$(id -u)" -eq 0 ] && command -v apt-get > /dev/null; then
    echo "installing ${missing[*]} for pictures by OpenGL and tests of the viewer's page"
    if apt_install "${missing[@]}"; then
        exit 0
    fi
fi
echo "not everything is there to draw with OpenGL and to test the viewer's page: pictures may come" \
    "from the slower software renderer, and tests be skipped; install ${missing[*]} for them"
