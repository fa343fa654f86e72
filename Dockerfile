# The workflow in a container: `docker build --tag lagsplat .`, then docs/how-to/cluster.md. Debian's Python is the one
# the lock is for; versions come from requirements/lock.txt.
FROM debian:bookworm-slim

RUN apt-get update \
    && apt-get install --yes --no-install-recommends ca-certificates git python3.11 python3.11-venv \
    && rm -rf /var/lib/apt/lists/*

# A further index in which pip finds torch, such as PyTorch's own of builds for the CPU, a tenth of those with CUDA.
ARG TORCH_INDEX
# Extras of pyproject.toml, as in `--build-arg EXTRAS=cuda,gap`.
ARG EXTRAS=cluster

WORKDIR /opt/lagsplat
COPY . .
# Any user may ask git for the commit.
RUN git config --system --add safe.directory /opt/lagsplat
RUN python3.11 -m venv /opt/venv \
    && /opt/venv/bin/pip install --no-cache-dir ${TORCH_INDEX:+--extra-index-url "$TORCH_INDEX"} \
       --constraint requirements/lock.txt torch \
    && /opt/venv/bin/pip install --no-cache-dir --constraint requirements/lock.txt --editable ".[$EXTRAS]"

# A container may run as a user without a name or a home, who cannot write to the image: what is kept is in /tmp.
ENV PATH=/opt/venv/bin:$PATH LOGNAME=lagsplat HOME=/tmp \
    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 OMP_WAIT_POLICY=PASSIVE \
    PYTHONDONTWRITEBYTECODE=1 NUMBA_CACHE_DIR=/tmp/lagsplat/numba \
    XDG_CACHE_HOME=/tmp/lagsplat/cache MPLCONFIGDIR=/tmp/lagsplat/matplotlib

WORKDIR /work
ENTRYPOINT ["snakemake", "--snakefile", "/opt/lagsplat/Snakefile"]
CMD ["--cores", "2", "--config", "hydra=profile=toy"]
