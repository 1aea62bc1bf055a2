"""Linear algebra has one thread inside, whichever threads ask for it."""

from concurrent.futures import ThreadPoolExecutor

import threadpoolctl

from wavefield.one_thread import one_thread


def blas_threads():
    return {pool["num_threads"] for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"}


def test_threads_of_a_pool_limit_what_the_main_thread_has_set():
    with threadpoolctl.threadpool_limits(limits=2, user_api="blas"):
        before = blas_threads()

        def inside(_):
            with one_thread():
                return blas_threads()

        with ThreadPoolExecutor(2) as pool:
            assert all(found <= {1} for found in pool.map(inside, range(8)))
        assert blas_threads() == before
