//! The table `[notifications]` of the settings file.

use std::path::PathBuf;
use std::time::Duration;

use axum::http::Uri;
use jiff::SignedDuration;
use lettre::message::Mailbox;
use lettre::transport::smtp::client::Certificate;
use serde::Deserialize;
use ureq::tls::RootCerts;

use super::error::NotificationError;
use super::mail::{Encryption, Mail};
use super::webhook::{self, Webhook};
use crate::estimate::Severity;
use crate::settings::{Secret, SettingError, certificates};
use crate::store::{Recipient, Recipients};

/// Timeout of an attempt.
const TIMEOUT: Duration = Duration::from_secs(30);

/// Maximum number of recipients; each has its own task.
const MAX_RECIPIENTS: usize = 100;

/// The table `notifications`.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NotificationsTable {
    /// Address of the dashboard, for links.
    dashboard_url: Option<String>,
    /// Maximum age of a record in hours: alarms raised by older ones are not notified.
    newer_than_h: Option<u32>,
    webhook: Vec<WebhookTable>,
    mail: Vec<MailTable>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct WebhookTable {
    name: String,
    url: String,
    secret_file: Option<PathBuf>,
    ca_file: Option<PathBuf>,
    at_least: Option<Severity>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct MailTable {
    name: String,
    /// `smtps://host[:465]`, `smtp://host[:587]` with STARTTLS, or `smtp+plain://host[:25]`.
    server: String,
    from: String,
    to: Vec<String>,
    username: Option<String>,
    password_file: Option<PathBuf>,
    ca_file: Option<PathBuf>,
    at_least: Option<Severity>,
}

/// The recipients and their transports.
pub struct NotificationSettings {
    recipients: Recipients,
    /// Transport of each recipient, by name.
    pub(super) transports: Vec<(String, Transport)>,
    pub(super) dashboard_url: Option<String>,
}

/// How a recipient is notified.
pub(super) enum Transport {
    Webhook(Webhook),
    Mail(Box<Mail>),
}

impl NotificationsTable {
    /// Resolves the table. `secret` returns the environment's secret for a recipient, whose name is passed in
    /// upper case with `_` for `-`; it overrides a file.
    ///
    /// # Errors
    /// [`NotificationError`] with the setting, its value and what was expected.
    pub fn resolve(
        self,
        secret: impl Fn(&str) -> Option<String>,
    ) -> Result<NotificationSettings, NotificationError> {
        let mut recipients = Recipients::default();
        if let Some(hours) = self.newer_than_h {
            recipients.newer_than = SignedDuration::from_hours(hours.into());
        }
        let mut transports = Vec::new();
        let env_secret = |name: &str| secret(&name.to_ascii_uppercase().replace('-', "_"));
        for table in self.webhook {
            let field = format!("notifications.webhook.{}", table.name);
            add(&mut recipients, &field, &table.name, table.at_least)?;
            let from_env = env_secret(&table.name);
            transports.push((table.name.clone(), Transport::Webhook(table.resolve(&field, from_env)?)));
        }
        for table in self.mail {
            let field = format!("notifications.mail.{}", table.name);
            add(&mut recipients, &field, &table.name, table.at_least)?;
            let from_env = env_secret(&table.name);
            transports
                .push((table.name.clone(), Transport::Mail(Box::new(table.resolve(&field, from_env)?))));
        }
        let dashboard_url = match self.dashboard_url {
            Some(url) if is_web_url(&url) => Some(url.trim_end_matches('/').to_owned()),
            Some(url) => {
                let expected = "http://… or https://…";
                return Err(SettingError::new("notifications.dashboard_url", url, expected).into());
            }
            None => None,
        };
        Ok(NotificationSettings { recipients, transports, dashboard_url })
    }
}

impl NotificationSettings {
    /// Returns the recipients that the store queues notifications for.
    pub fn recipients(&self) -> Recipients {
        self.recipients.clone()
    }
}

/// Adds a recipient; checks that its name is unique and valid in metrics and environment variables.
fn add(
    recipients: &mut Recipients,
    field: &str,
    name: &str,
    at_least: Option<Severity>,
) -> Result<(), SettingError> {
    let is_valid = (1..=40).contains(&name.len())
        && name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-');
    if !is_valid {
        let expected = "1 to 40 lower-case letters, digits and -";
        return Err(SettingError::new(format!("{field}.name"), format!("{name:?}"), expected));
    }
    if recipients.list.iter().any(|other| other.name == name) {
        return Err(SettingError::new(format!("{field}.name"), name, "a unique name"));
    }
    if recipients.list.len() == MAX_RECIPIENTS {
        return Err(SettingError::new(field, "recipient 101", "at most 100 recipients"));
    }
    let at_least = at_least.unwrap_or(Severity::Warning);
    recipients.list.push(Recipient { name: name.to_owned(), at_least });
    Ok(())
}

impl WebhookTable {
    fn resolve(self, field: &str, from_env: Option<String>) -> Result<Webhook, SettingError> {
        if !is_web_url(&self.url) {
            // The value is not repeated: it may contain a password.
            let expected = "http://host… or https://host… without a user";
            return Err(SettingError::new(format!("{field}.url"), "invalid", expected));
        }
        let secret_field = format!("{field}.secret_file");
        let secret = Secret::new(secret_field.clone(), from_env, self.secret_file)
            .ok_or_else(|| SettingError::new(secret_field, "missing", "a file with the secret"))?;
        // Reports an invalid key at the start instead of with each attempt.
        webhook::key(&secret)?;
        let authorities = match &self.ca_file {
            None => RootCerts::WebPki,
            Some(path) => RootCerts::from(certificates(&format!("{field}.ca_file"), path)?),
        };
        Ok(Webhook::new(self.url, secret, authorities, TIMEOUT))
    }
}

impl MailTable {
    fn resolve(self, field: &str, from_env: Option<String>) -> Result<Mail, NotificationError> {
        let (encryption, host, port) = parse_server(&format!("{field}.server"), &self.server)?;
        let mailbox = |name: &str, address: &str| {
            let invalid = |_| {
                let expected = "an address, someone@host or Name <someone@host>";
                SettingError::new(format!("{field}.{name}"), address, expected)
            };
            address.parse::<Mailbox>().map_err(invalid)
        };
        if self.to.is_empty() {
            return Err(SettingError::new(format!("{field}.to"), "empty", "at least one address").into());
        }
        let password = Secret::new(format!("{field}.password_file"), from_env, self.password_file);
        let login = match (self.username, password) {
            (None, None) => None,
            (Some(_), Some(_)) if encryption == Encryption::None => {
                let expected = "smtps:// or smtp://, as there is a password";
                return Err(SettingError::new(format!("{field}.server"), self.server, expected).into());
            }
            (Some(user), Some(password)) => {
                password.text()?;
                Some((user, password))
            }
            (Some(_), None) => {
                let expected = "a file with the user's password";
                return Err(SettingError::new(format!("{field}.password_file"), "missing", expected).into());
            }
            (None, Some(_)) => {
                let expected = "the user of the password";
                return Err(SettingError::new(format!("{field}.username"), "missing", expected).into());
            }
        };
        let authorities = match &self.ca_file {
            None => None,
            Some(path) => {
                let list = certificates(&format!("{field}.ca_file"), path)?;
                let ders = list.iter().map(|certificate| Certificate::from_der(certificate.der().to_vec()));
                Some(ders.collect::<Result<_, _>>()?)
            }
        };
        let to: Result<Vec<_>, _> = self.to.iter().map(|to| mailbox("to", to)).collect();
        Ok(Mail {
            host,
            port,
            encryption,
            authorities,
            login,
            from: mailbox("from", &self.from)?,
            to: to?,
            timeout: TIMEOUT,
        })
    }
}

/// Whether it is an HTTP or HTTPS URL without a user.
fn is_web_url(url: &str) -> bool {
    let uri: Result<Uri, _> = url.parse();
    uri.is_ok_and(|uri| {
        matches!(uri.scheme_str(), Some("http" | "https"))
            && uri.host().is_some_and(|host| !host.is_empty())
            && uri.authority().is_some_and(|authority| !authority.as_str().contains('@'))
    })
}

/// Parses the URL of a mail server into encryption, host and port.
fn parse_server(field: &str, url: &str) -> Result<(Encryption, String, u16), SettingError> {
    let invalid = || {
        let expected = "smtps://host[:465], smtp://host[:587] with STARTTLS, or smtp+plain://host[:25]";
        // The value is not repeated: it may contain a password.
        SettingError::new(field, "invalid", expected)
    };
    let uri: Uri = url.parse().map_err(|_| invalid())?;
    let (encryption, port) = match uri.scheme_str() {
        Some("smtps") => (Encryption::Tls, 465),
        Some("smtp") => (Encryption::StartTls, 587),
        Some("smtp+plain") => (Encryption::None, 25),
        _ => return Err(invalid()),
    };
    let authority = uri.authority().ok_or_else(invalid)?;
    let is_bare = matches!(uri.path(), "" | "/") && uri.query().is_none();
    if !is_bare || authority.as_str().contains('@') || authority.host().is_empty() {
        return Err(invalid());
    }
    // An IPv6 address is resolved without its brackets.
    let host = authority.host().trim_matches(['[', ']']);
    Ok((encryption, host.to_owned(), authority.port_u16().unwrap_or(port)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECRET: &str = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw";

    fn resolve(text: &str) -> Result<NotificationSettings, String> {
        let table: NotificationsTable = toml::from_str(text).map_err(|error| error.to_string())?;
        let secret = |name: &str| match name {
            "CM_MS" => Some(SECRET.to_owned()),
            "WEAK" => Some("whsec_c2VjcmV0".to_owned()),
            "LOGIN" => Some("secret".to_owned()),
            _ => None,
        };
        table.resolve(secret).map_err(|error| error.to_string())
    }

    #[test]
    fn webhooks_and_mails_are_resolved() {
        let settings = resolve(
            "dashboard_url = \"https://host/\"\nnewer_than_h = 2\n\
             [[webhook]]\nname = \"cm-ms\"\nurl = \"https://cmms/hook?x=1\"\nat_least = \"danger\"\n\
             [[mail]]\nname = \"login\"\nserver = \"smtps://mail\"\nfrom = \"Watch <w@x.org>\"\nto = [\"a@x.org\"]\nusername = \"w\"\n",
        )
        .unwrap();
        let recipient = |name: &str, at_least| Recipient { name: name.to_owned(), at_least };
        let list = vec![recipient("cm-ms", Severity::Danger), recipient("login", Severity::Warning)];
        assert_eq!(settings.recipients(), Recipients { list, newer_than: SignedDuration::from_hours(2) });
        assert_eq!(settings.dashboard_url.as_deref(), Some("https://host"));
        let Transport::Mail(mail) = &settings.transports[1].1 else { panic!("expected a mail") };
        assert_eq!((mail.host.as_str(), mail.port, mail.encryption), ("mail", 465, Encryption::Tls));
        let relay = parse_server("server", "smtp+plain://[::1]").unwrap();
        assert_eq!(relay, (Encryption::None, "::1".to_owned(), 25));
    }

    #[test]
    fn errors_name_the_setting_but_no_secret() {
        let hook = |rest: &str| format!("[[webhook]]\n{rest}");
        let mail = |rest: &str| format!("[[mail]]\nname = \"shift\"\nfrom = \"w@x.org\"\n{rest}");
        let to = "to = [\"a@x.org\"]\n";
        for (text, words) in [
            ("dashboard_url = \"host\"".to_owned(), "dashboard_url is host"),
            (hook("name = \"A b\"\nurl = \"http://x\""), "name is \"A b\""),
            (hook("name = \"x\"\nurl = \"http://x\""), "webhook.x.secret_file is missing"),
            (hook("name = \"weak\"\nurl = \"http://x\""), "whsec_"),
            (hook("name = \"cm-ms\"\nurl = \"http://u:secret@x\""), "webhook.cm-ms.url"),
            (hook("name = \"cm-ms\"\nurl = \"ftp://x\""), "https://host"),
            (hook("name = \"x\"\nurl = \"http://x\"\nsecret_file = \"/nowhere/s\""), "/nowhere/s"),
            (
                hook("name = \"cm-ms\"\nurl = \"http://x\"\nca_file = \"/nowhere/ca\""),
                "webhook.cm-ms.ca_file",
            ),
            (hook("name = \"cm-ms\"\nurl = \"http://x\"\nat_least = \"bad\""), "at_least"),
            (mail(&format!("server = \"mail\"\n{to}")), "mail.shift.server"),
            (mail("server = \"smtp://mail\"\nto = []"), "mail.shift.to is empty"),
            (mail("server = \"smtp://mail\"\nto = [\"a b\"]"), "mail.shift.to is a b"),
            (mail(&format!("server = \"smtp://mail\"\nusername = \"u\"\n{to}")), "mail.shift.password_file"),
            (mail(&format!("server = \"smtp://u:secret@mail\"\n{to}")), "mail.shift.server"),
            (
                format!(
                    "[[mail]]\nname = \"login\"\nfrom = \"w@x.org\"\nserver = \"smtp+plain://m\"\nusername = \"u\"\n{to}"
                ),
                "as there is a password",
            ),
            (
                format!("[[mail]]\nname = \"login\"\nfrom = \"w@x.org\"\nserver = \"smtp://m\"\n{to}"),
                "username is missing",
            ),
        ] {
            let error = resolve(&text).map(|_| ()).unwrap_err();
            assert!(error.contains(words), "{text}: {error}");
            assert!(!error.contains("u:secret") && !error.contains("c2Vjcm"), "{error}");
        }
    }
}
