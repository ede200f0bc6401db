//! Notifications by e-mail, received by a mail server in the test.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

use flankwatch::notifications::{NotificationsTable, Notifier};
use serde_json::{Value, json};
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{ServerConfig, ServerConnection, StreamOwned};

use crate::alarms::{at_once, loud, watched};
use crate::certificate::certificate;
use crate::notifications::{SOON, one_recipient, stop, wait_for};
use crate::running::Service;

/// The encryption of a test mail server.
#[derive(Clone)]
enum Speech {
    Plain,
    Tls(Arc<ServerConfig>),
    StartTls(Arc<ServerConfig>),
}

/// A mail server that defers the first message and accepts all others.
struct MailServer {
    port: u16,
    mails: Receiver<String>,
}

impl MailServer {
    fn start(speech: Speech) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let (sender, mails) = channel();
        std::thread::spawn(move || {
            let mut refused = false;
            for connection in listener.incoming() {
                // A client that does not trust this server disconnects.
                let _ = serve(connection.unwrap(), &speech, &sender, &mut refused);
            }
        });
        Self { port, mails }
    }
}

fn serve(
    mut connection: TcpStream,
    speech: &Speech,
    mails: &Sender<String>,
    refused: &mut bool,
) -> std::io::Result<()> {
    let tls = |config: &Arc<ServerConfig>, connection: TcpStream| {
        StreamOwned::new(ServerConnection::new(Arc::clone(config)).unwrap(), connection)
    };
    if !matches!(speech, Speech::Tls(_)) {
        connection.write_all(b"220 mail.test\r\n")?;
    }
    match speech {
        Speech::Plain => take_mail(connection, "250 mail.test", mails, refused).map(|_| ()),
        Speech::Tls(config) => {
            let mut connection = tls(config, connection);
            connection.write_all(b"220 mail.test\r\n")?;
            take_mail(connection, "250-mail.test\r\n250 AUTH PLAIN", mails, refused).map(|_| ())
        }
        Speech::StartTls(config) => {
            let asked = take_mail(connection, "250-mail.test\r\n250 STARTTLS", mails, refused)?;
            let Some(connection) = asked else { return Ok(()) };
            take_mail(tls(config, connection), "250-mail.test\r\n250 AUTH PLAIN", mails, refused).map(|_| ())
        }
    }
}

/// Serves SMTP on a connection until its end, or returns the connection on STARTTLS.
fn take_mail<S: Read + Write>(
    connection: S,
    able: &str,
    mails: &Sender<String>,
    refused: &mut bool,
) -> std::io::Result<Option<S>> {
    let mut reader = BufReader::new(connection);
    let reply = |reader: &mut BufReader<S>, line: &str| {
        reader.get_mut().write_all(format!("{line}\r\n").as_bytes())?;
        reader.get_mut().flush()
    };
    let mut login = String::new();
    loop {
        let mut line = String::new();
        if reader.read_line(&mut line)? == 0 {
            return Ok(None);
        }
        match line.get(..4).unwrap_or_default() {
            "EHLO" => reply(&mut reader, able)?,
            "STAR" => {
                reply(&mut reader, "220 go on")?;
                return Ok(Some(reader.into_inner()));
            }
            "AUTH" => {
                login = line.clone();
                reply(&mut reader, "235 welcome")?;
            }
            "DATA" => {
                reply(&mut reader, "354 go on")?;
                let mut mail = login.clone();
                while !mail.ends_with("\r\n.\r\n") {
                    reader.read_line(&mut mail)?;
                }
                if *refused {
                    let _ = mails.send(mail);
                    reply(&mut reader, "250 kept")?;
                } else {
                    *refused = true;
                    reply(&mut reader, "451 later")?;
                }
            }
            "QUIT" => return reply(&mut reader, "221 bye").map(|()| None),
            _ => reply(&mut reader, "250 ok")?,
        }
    }
}

#[test]
fn a_mail_that_a_server_defers_is_sent_again() {
    let service = Service::start_with(one_recipient);
    let mut asset = watched("pump", &at_once());
    asset["name"] = json!("Förderpumpe");
    service.post_json("/v1/assets", &asset).expect(201);
    let server = MailServer::start(Speech::Plain);
    let notifier = service.run(async {
        let table: NotificationsTable = toml::from_str(&format!(
            "[[mail]]\nname = \"all\"\nserver = \"smtp+plain://127.0.0.1:{}\"\nfrom = \"Watch <watch@plant.example>\"\nto = [\"shift@plant.example\", \"ada@plant.example\"]\n",
            server.port
        ))
        .unwrap();
        Notifier::start(table.resolve(|_| None).unwrap(), &service.service())
    });
    service.upload("pump", &loud(0, 4.0));
    let shown = wait_for(&service, "all", |shown| !shown["error"].is_null());
    assert!(shown["error"].as_str().unwrap().contains("later"), "{shown}");
    service.clock.advance(6);
    let mail = server.mails.recv_timeout(SOON).unwrap();
    let shown = wait_for(&service, "all", |shown| shown["sent"] == 1);
    assert_eq!(shown["error"], Value::Null);
    for words in [
        "From: Watch <watch@plant.example>",
        "To: shift@plant.example, ada@plant.example",
        "Auto-Submitted: auto-generated",
        "@plant.example>\r\n",
        "Severity   danger",
        "Quantity   RMS",
    ] {
        assert!(mail.contains(words), "{words} in {mail}");
    }
    stop(&service, notifier);
}

#[test]
#[ignore = "needs openssl"]
fn mail_is_sent_over_tls_to_a_trusted_server_only() {
    let folder = tempfile::tempdir().unwrap();
    let files = certificate(folder.path());
    let chain = CertificateDer::pem_file_iter(&files.certificate).unwrap().map(Result::unwrap).collect();
    let key = PrivateKeyDer::from_pem_file(&files.key).unwrap();
    let config = ServerConfig::builder().with_no_client_auth().with_single_cert(chain, key).unwrap();
    let config = Arc::new(config);
    let password = folder.path().join("password");
    std::fs::write(&password, "open sesame\n").unwrap();
    for (scheme, speech) in [("smtps", Speech::Tls(config.clone())), ("smtp", Speech::StartTls(config))] {
        let service = Service::start_with(one_recipient);
        service.post_json("/v1/assets", &watched("pump", &at_once())).expect(201);
        let server = MailServer::start(speech);
        let sends_with = |trust: &str| {
            let table = format!(
                "[[mail]]\nname = \"all\"\nserver = \"{scheme}://127.0.0.1:{}\"\nfrom = \"watch@plant.example\"\nto = [\"ada@plant.example\"]\n\
                 username = \"watch\"\npassword_file = {password:?}\n{trust}",
                server.port
            );
            let table: NotificationsTable = toml::from_str(&table).unwrap();
            let settings = table.resolve(|_| None).unwrap();
            service.run(async { Notifier::start(settings, &service.service()) })
        };
        // The certificate has no known CA: nothing is sent, least of all the password.
        let notifier = sends_with("");
        service.upload("pump", &loud(0, 4.0));
        let shown = wait_for(&service, "all", |shown| !shown["error"].is_null());
        assert!(shown["error"].as_str().unwrap().contains("certificate"), "{scheme}: {shown}");
        stop(&service, notifier);
        let notifier = sends_with(&format!("ca_file = {:?}\n", files.certificate));
        let began = Instant::now();
        let shown = loop {
            assert!(began.elapsed() < SOON, "{scheme}: not sent");
            service.clock.advance(6);
            let shown = wait_for(&service, "all", |_| true);
            if shown["sent"] == 1 {
                break shown;
            }
            std::thread::sleep(Duration::from_millis(100));
        };
        assert_eq!(shown["error"], Value::Null, "{scheme}");
        let mail = server.mails.recv_timeout(SOON).unwrap();
        // The name and the password, each after a zero.
        assert!(mail.starts_with("AUTH PLAIN AHdhdGNoAG9wZW4gc2VzYW1l\r\n"), "{mail}");
        assert!(mail.contains("Severity   danger"), "{mail}");
        stop(&service, notifier);
    }
}
