//! E-mails over SMTP.

use std::time::Duration;

use lettre::message::Mailbox;
use lettre::message::header::{ContentType, HeaderName, HeaderValue};
use lettre::transport::smtp::authentication::Credentials;
use lettre::transport::smtp::client::{Certificate, CertificateStore, Tls, TlsParameters};
use lettre::{AsyncSmtpTransport, AsyncTransport, Tokio1Executor};

use super::error::NotificationError;
use super::message::Message;
use crate::settings::Secret;

/// Encryption of the connection to a mail server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encryption {
    /// TLS from the first byte.
    Tls,
    /// STARTTLS on a plain connection, required.
    StartTls,
    /// No encryption.
    None,
}

/// A mail server with the sender and the recipients.
#[derive(Clone)]
pub(super) struct Mail {
    pub(super) host: String,
    pub(super) port: u16,
    pub(super) encryption: Encryption,
    /// CA certificates to verify the server with; default: the public CAs.
    pub(super) authorities: Option<Vec<Certificate>>,
    pub(super) login: Option<(String, Secret)>,
    pub(super) from: Mailbox,
    pub(super) to: Vec<Mailbox>,
    pub(super) timeout: Duration,
}

impl Mail {
    /// Sends a message.
    pub(super) async fn send(&self, message: &Message) -> Result<(), NotificationError> {
        let mail = self.compose(message)?;
        let transport = self.transport()?;
        match tokio::time::timeout(self.timeout, transport.send(mail)).await {
            Ok(sent) => sent.map(|_| ()).map_err(NotificationError::from),
            Err(_) => Err(NotificationError::Timeout(self.timeout.as_secs())),
        }
    }

    /// Composes the e-mail. Its Message-ID is the same when it is sent again, so that mail servers and
    /// clients recognise duplicates.
    fn compose(&self, message: &Message) -> Result<lettre::Message, NotificationError> {
        let id = format!("<{}@{}>", message.notification.id, self.from.email.domain());
        let mut mail = lettre::Message::builder()
            .from(self.from.clone())
            .subject(message.subject())
            .message_id(Some(id))
            .date(message.notification.noted_at.into());
        for to in &self.to {
            mail = mail.to(to.clone());
        }
        let automatic = HeaderName::new_from_ascii_str("Auto-Submitted");
        let mail = mail.raw_header(HeaderValue::new(automatic, "auto-generated".to_owned()));
        Ok(mail.header(ContentType::TEXT_PLAIN).body(message.text())?)
    }

    fn transport(&self) -> Result<AsyncSmtpTransport<Tokio1Executor>, NotificationError> {
        let tls = match self.encryption {
            Encryption::Tls => Tls::Wrapper(self.tls()?),
            Encryption::StartTls => Tls::Required(self.tls()?),
            Encryption::None => Tls::None,
        };
        let mut transport = AsyncSmtpTransport::<Tokio1Executor>::builder_dangerous(&self.host)
            .port(self.port)
            .timeout(Some(self.timeout))
            .tls(tls);
        if let Some((user, password)) = &self.login {
            transport = transport.credentials(Credentials::new(user.clone(), password.text()?));
        }
        Ok(transport.build())
    }

    fn tls(&self) -> Result<TlsParameters, NotificationError> {
        let mut tls = TlsParameters::builder(self.host.clone());
        if let Some(authorities) = &self.authorities {
            tls = tls.certificate_store(CertificateStore::None);
            for certificate in authorities {
                tls = tls.add_root_certificate(certificate.clone());
            }
        }
        Ok(tls.build()?)
    }
}
