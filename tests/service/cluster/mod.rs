//! Several processes as one service: API nodes, workers, NATS JetStream between them, PostgreSQL behind them.

mod faults;
mod nodes;
mod postgres;
mod processes;
mod proxy;
mod queue;
mod resumable;
mod same_bits;
mod site;
mod tokens;
mod upkeep;
