# syntax=docker/dockerfile:1
# An image with the command packit and the base installation. It has not been built yet; its steps were
# tried one by one in a virtual environment.
#
#     docker build -t packit-sim .
#     docker run --rm --user "$(id -u)" -v "$PWD:/work" packit-sim demo
FROM python:3.11-slim-bookworm

# libEGL and Mesa make pictures faster. binutils makes PyBullet smaller, and goes again.
# hadolint ignore=DL3008
RUN --mount=type=bind,target=/src,rw \
    apt-get update \
    && apt-get install -y --no-install-recommends libegl1 libgl1-mesa-dri binutils \
    && pip install --no-cache-dir --constraint /src/constraints.txt /src \
    && bash /src/scripts/slim-pybullet.sh /usr/local \
    && apt-get purge -y --auto-remove binutils \
    && rm -rf /var/lib/apt/lists/*

# Any user may run the image, and finds the compiled kernels.
ENV NUMBA_CACHE_DIR=/var/cache/packit/kernels \
    PACKIT_CACHE=/var/cache/packit/shapes
RUN useradd --create-home --uid 1000 packit \
    && mkdir --mode 777 /work /var/cache/packit
USER 1000
WORKDIR /work
RUN umask 000 \
    && packit doctor --compile

ENTRYPOINT ["packit"]
CMD ["--help"]
