#!/usr/bin/env bash
# Installs what its arguments name, if it is missing: `egl`, libEGL and a Mesa driver, with which
# PyBullet draws pictures by OpenGL without a screen, and `chromium`, in which the tests open pages.
# Never fails: without them the software renderer draws, and those tests are skipped.
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
for name in "$@"; do
    case $name in
        egl)
            have_egl || missing+=(libegl1)
            have_driver || missing+=(libgl1-mesa-dri)
            ;;
        chromium) have_chromium || missing+=(chromium) ;;
    esac
done
if [ ${#missing[@]} -eq 0 ]; then
    exit 0
fi
if [ "$(id -u)" -eq 0 ] && command -v apt-get > /dev/null; then
    echo "installing ${missing[*]} with apt"
    if apt_install "${missing[@]}"; then
        exit 0
    fi
fi
echo "${missing[*]} could not be installed (apt install ${missing[*]}): the software renderer draws" \
    "pictures, and tests that need a browser are skipped"
