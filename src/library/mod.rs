//! The grid of simulated wear states: its building and its file format.
