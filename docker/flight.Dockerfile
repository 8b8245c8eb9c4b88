# What a drone's computer needs, for x86-64 and aarch64:
#   docker build -f docker/flight.Dockerfile -t monoloc .
#   docker run --rm --device /dev/video0 -v "$PWD:/flight" monoloc fly flight.toml
FROM python:3.12-slim-bookworm AS build
# hadolint ignore=DL3008
RUN apt-get update && apt-get install -y --no-install-recommends g++ && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY . .
ARG MONOLOC_COMMIT=""
ENV MONOLOC_COMMIT=$MONOLOC_COMMIT
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM python:3.12-slim-bookworm
COPY --from=build /wheels /wheels
COPY constraints.txt /wheels/
# Compiled to bytecode: whoever runs it may not write it, and then each start takes longer and 15 MB more.
RUN pip install --no-cache-dir --find-links /wheels --constraint /wheels/constraints.txt \
      "monoloc[mavlink,mcap,stream]" \
    && rm -r /wheels \
    && useradd --create-home --uid 1000 --groups video,dialout pilot
USER 1000
WORKDIR /flight
ENTRYPOINT ["monoloc"]
CMD ["--help"]
