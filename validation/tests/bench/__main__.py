"""``python -m validation.tests.bench``: what integrators, engines and batches cost, as ratios taken in one run."""

from validation.tests.bench.bench import bench
from validation.tests.bench.bench_batch import bench_batch

if __name__ == "__main__":
    bench()
    bench_batch()
