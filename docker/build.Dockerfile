# What a computer that builds rooms needs, without a GPU:
#   docker build -f docker/build.Dockerfile -t monoloc-build .
#   docker run --rm -v "$PWD:/rooms" monoloc-build build my-recording --out room.monoloc
FROM python:3.12-slim-bookworm AS build
# hadolint ignore=DL3008
RUN apt-get update && apt-get install -y --no-install-recommends g++ && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY . .
ARG MONOLOC_COMMIT=""
ENV MONOLOC_COMMIT=$MONOLOC_COMMIT
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels . ./lab

FROM python:3.12-slim-bookworm
COPY --from=build /wheels /wheels
COPY constraints.txt /wheels/
# PyTorch's own index has wheels without CUDA.
RUN pip install --no-cache-dir --find-links /wheels --constraint /wheels/constraints.txt \
      --extra-index-url https://download.pytorch.org/whl/cpu \
      "monoloc[build,record3d,ros]" monoloc-lab \
    && rm -r /wheels \
    && useradd --create-home --uid 1000 builder
USER 1000
WORKDIR /rooms
ENTRYPOINT ["monoloc"]
CMD ["--help"]
