"""Let NumPy and SciPy use one thread in all tests, as commands do; imported before both."""

from pupper_analysis.base.drivers import use_one_blas_thread

use_one_blas_thread()
