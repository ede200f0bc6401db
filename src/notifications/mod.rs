//! Notifications of alarms: webhooks and e-mails to those whom the settings name.
//!
//! What is told is a row of the store, written in the transaction that changes the alarm
//! ([`crate::store::Recipients`] says to whom). Each process that has the settings looks for rows that are
//! due, takes the right to one for a while, sends it, and says what became of it. Who dies in between leaves
//! a row that is due again: each notification is sent at least once, and carries an identifier by which its
//! receiver knows a repeat.

mod error;
mod mail;
mod message;
mod secret;
mod sender;
mod settings;
mod webhook;

pub use error::NotificationError;
pub use sender::Notifier;
pub use settings::{NotificationSettings, NotificationsTable};
