//! The only SQL and the only raw-object paths.
