//! Several processes as one service: API nodes, workers, NATS JetStream between them, PostgreSQL behind them.

mod nodes;
mod same_bits;
