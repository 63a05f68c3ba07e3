# The command with its live page and an embedded broker: docs/container.md.
FROM python:3.11-slim AS build
WORKDIR /src
RUN python -m venv /opt/plotfeed
ENV PATH=/opt/plotfeed/bin:$PATH PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1
COPY requirements/run.txt requirements/
RUN pip install --require-hashes --requirement requirements/run.txt
COPY pyproject.toml README.md LICENSE ./
COPY feeds feeds
COPY models models
COPY proto proto
COPY replay replay
COPY face face
RUN pip install --no-deps --no-build-isolation .
RUN pip uninstall --yes setuptools pip

FROM python:3.11-slim
COPY --from=build /opt/plotfeed /opt/plotfeed
ENV PATH=/opt/plotfeed/bin:$PATH PYTHONUNBUFFERED=1
# Files that are mounted here are the user's: docker run --user says who that is.
WORKDIR /data
USER 10001:10001
EXPOSE 8590
# No shell between: what stops the container stops plotfeed.
ENTRYPOINT ["plotfeed"]
CMD ["demo", "--page", "0.0.0.0:8590"]
