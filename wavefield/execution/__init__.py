"""Where the work runs: processes, Dask clusters and Slurm jobs behind one map; locks, logs, signals."""
