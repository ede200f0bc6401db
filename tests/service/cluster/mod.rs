//! Several processes as one service: API nodes, workers, NATS JetStream between them, PostgreSQL behind them.

mod faults;
mod nodes;
mod processes;
mod proxy;
mod same_bits;
