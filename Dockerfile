# An image with the command packit and its base install. This file has not been built yet; its RUN lines have been run.
#
#     docker build -t packit-sim .
#     docker run --rm --user "$(id -u)" -v "$PWD:/work" packit-sim demo
FROM python:3.11-slim-bookworm

# OpenGL without a screen, which makes pictures faster.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends libegl1 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*

COPY . /src
RUN pip install --no-cache-dir --constraint /src/constraints.txt /src \
    && bash /src/scripts/slim-pybullet.sh /usr/local

# Any user may run the image, and finds the compiled kernels.
ENV NUMBA_CACHE_DIR=/var/cache/packit/kernels \
    PACKIT_CACHE=/var/cache/packit/shapes
RUN useradd --create-home --uid 1000 packit \
    && mkdir --mode 777 /work /var/cache/packit
USER 1000
WORKDIR /work
RUN umask 000 && packit demo --generations 1 --out /tmp/demo && rm -r /tmp/demo

ENTRYPOINT ["packit"]
CMD ["--help"]
