"""Run chunks in processes, Dask clusters or Slurm jobs behind one map function; keep locks and logs."""
