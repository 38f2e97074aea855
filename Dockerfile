# Trains the first team: docker build -t assistax . && docker run -v $PWD/runs:/assistax/runs assistax
FROM python:3.12-slim
RUN apt-get update && apt-get install -y --no-install-recommends libegl1 libgl1 && rm -rf /var/lib/apt/lists/*
WORKDIR /assistax
COPY . .
RUN pip install --no-cache-dir uv && uv sync --frozen --no-dev
ENTRYPOINT ["uv", "run", "--no-dev", "assistax"]
CMD ["train", "scratch"]
