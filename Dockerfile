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

RUN useradd --create-home --uid 1000 packit && mkdir /work && chown packit /work
USER 1000
WORKDIR /work

# Compiles and caches the kernels, and shows that the image works.
RUN packit demo --generations 1 --out /tmp/demo && rm -r /tmp/demo

ENTRYPOINT ["packit"]
CMD ["--help"]
