# Volumes rendered and looked at on any machine with x86-64: no GPU, no OpenGL, no X, no root.
#   docker build -t clvol .
#   docker run --rm -p 127.0.0.1:8765:8765 -v "$PWD:/data:ro" clvol view /data/scan.nii.gz --serve --host 0.0.0.0 --port 8765
FROM python:3.12-slim-bookworm
# PoCL links each kernel with ld, against libgcc and libc
RUN apt-get update \
    && apt-get install --yes --no-install-recommends binutils gcc libc6-dev \
    && rm -rf /var/lib/apt/lists/*
COPY pyproject.toml README.md LICENSE /opt/clvol/
COPY src /opt/clvol/src
COPY cl /opt/clvol/cl
RUN pip install --no-cache-dir "/opt/clvol[pocl,view,medical]"
RUN useradd --create-home --home-dir /clvol --uid 1000 clvol
USER clvol
WORKDIR /clvol
# the kernels of a first picture are built here, not when somebody waits
RUN clvol render phantom:marschner-lobb --size 64 64 --output first.png
EXPOSE 8765
ENTRYPOINT ["clvol"]
CMD ["view", "phantom:marschner-lobb", "--serve", "--host", "0.0.0.0", "--port", "8765"]
