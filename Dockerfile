# SPDX-License-Identifier: Apache-2.0
# For x86-64. From the folder of this file:
#
#   docker build --tag skymoor .
#   docker run --rm --volume "$PWD:/data" --user "$(id -u):$(id -g)" skymoor run site.toml --out result
#
# The folder that is mounted at /data holds site.toml, the photos and the reference, and receives the results.
# Extras are chosen with --build-arg EXTRAS=plot,nerf. Those that need PyTorch bring it for CUDA, which is gigabytes; with
# --build-arg PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu they bring it for CPUs.

FROM python:3.11-slim-bookworm AS build
ENV PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1 PIP_ROOT_USER_ACTION=ignore
WORKDIR /source
COPY LICENSE README.md pyproject.toml requirements.lock ./
COPY src src
# The lock pins setuptools as well, so the build takes nothing that is not pinned.
RUN pip install --constraint requirements.lock setuptools \
    && pip wheel --no-deps --no-build-isolation --wheel-dir /wheels .
ARG EXTRAS=""
ARG PIP_EXTRA_INDEX_URL
RUN python -m venv /opt/skymoor \
    && /opt/skymoor/bin/pip install --constraint requirements.lock "$(echo /wheels/skymoor-*.whl)${EXTRAS:+[$EXTRAS]}"

FROM python:3.11-slim-bookworm
LABEL org.opencontainers.image.title="skymoor" org.opencontainers.image.licenses="Apache-2.0"
# What the wheels link to and do not contain. Open3D: libegl1, libgl1, libidn2-0, libudev1, libx11-6 (and libusb, which
# comes from the wheel libusb-package). GDAL in rasterio: libexpat1. Nothing is drawn on a screen.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libegl1 libexpat1 libgl1 libidn2-0 libudev1 libx11-6 \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --create-home --uid 1000 skymoor \
    && install --directory --owner=skymoor --group=skymoor /data
COPY --from=build /opt/skymoor /opt/skymoor
# Weights that are fetched lie beside the data, or they would be gone with the container.
ENV PATH="/opt/skymoor/bin:$PATH" PYTHONUNBUFFERED=1 SKYMOOR_WEIGHTS=/data/weights
USER 1000:1000
WORKDIR /data
VOLUME ["/data"]
ENTRYPOINT ["skymoor"]
CMD ["--help"]
