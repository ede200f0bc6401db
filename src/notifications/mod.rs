//! Notifications of alarms: webhooks and e-mails to the configured recipients.
//!
//! A notification is a row of the store, written in the transaction that changes the alarm, for each of the
//! [`Recipients`](crate::store::Recipients). Each process with notification settings polls for due rows,
//! leases one, sends it and records the outcome. If the process dies in between, the lease expires and the
//! row is due again: each notification is sent at least once, with an identifier by which its receiver
//! recognises a duplicate.

mod error;
mod mail;
mod message;
mod sender;
mod settings;
mod webhook;

pub use error::NotificationError;
pub use sender::Notifier;
pub use settings::{NotificationSettings, NotificationsTable};
