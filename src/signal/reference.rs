//! Comparison with SciPy.
