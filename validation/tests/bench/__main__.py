"""``python -m validation.tests.bench``: cost of integrators, engines, batches, fits and the report, in one run."""

from validation.tests.bench.bench import bench
from validation.tests.bench.bench_batch import bench_batch
from validation.tests.bench.bench_fit import bench_fit
from validation.tests.bench.bench_large import bench_large
from validation.tests.bench.bench_report import bench_report

if __name__ == "__main__":
    bench()
    bench_large()
    bench_batch()
    bench_fit()
    bench_report()
