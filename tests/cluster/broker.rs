//! MQTT brokers for the tests, with a sender and a listener.

use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{ConnectProperties, Packet, PublishProperties};
use rumqttc::v5::{Client, Connection, Event, MqttOptions};
use serde_json::Value;
use tempfile::TempDir;

use flankwatch_test_support::needed;

/// Timeout of everything between services and brokers, for a busy machine.
pub(crate) const LONGEST: Duration = Duration::from_secs(60);

/// A Mosquitto broker on a free port.
pub(crate) struct Broker {
    child: Option<Child>,
    program: PathBuf,
    folder: TempDir,
    pub(crate) port: u16,
}

impl Broker {
    /// Starts a broker that accepts anonymous clients.
    pub(crate) fn start() -> Self {
        Self::start_with(|_| "allow_anonymous true\n".to_owned())
    }

    /// Starts a broker with additional settings, which may name files that the closure creates in the given
    /// folder.
    pub(crate) fn start_with(settings: impl FnOnce(&Path) -> String) -> Self {
        let program = needed(mosquitto(), "mosquitto (apt install mosquitto)");
        let folder = tempfile::tempdir().unwrap();
        let port = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap().local_addr().unwrap().port();
        let path = folder.path();
        // On a stop, the broker writes every acknowledged message to disk.
        let text = format!(
            "listener {port} 127.0.0.1\nuser root\npersistence true\npersistence_location {}/\nmax_queued_messages 0\n{}",
            path.display(),
            settings(path)
        );
        std::fs::write(path.join("mosquitto.conf"), text).unwrap();
        let mut broker = Self { child: None, program, folder, port };
        broker.launch();
        broker
    }

    pub(crate) fn launch(&mut self) {
        let child = Command::new(&self.program)
            .arg("-c")
            .arg(self.folder.path().join("mosquitto.conf"))
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
        self.child = Some(child.unwrap());
        let began = Instant::now();
        while TcpStream::connect((Ipv4Addr::LOCALHOST, self.port)).is_err() {
            assert!(began.elapsed() < LONGEST, "mosquitto does not listen on port {}", self.port);
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Stops the broker: `-TERM` lets it save its state, `-KILL` does not.
    pub(crate) fn end(&mut self, signal: &str) {
        let mut child = self.child.take().unwrap();
        let sent = Command::new("kill").args([signal, &child.id().to_string()]).status();
        assert!(sent.unwrap().success());
        child.wait().unwrap();
    }
}

impl Drop for Broker {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Debian installs it in a folder that is only in root's path.
fn mosquitto() -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&path)
        .chain([PathBuf::from("/usr/sbin")])
        .map(|folder| folder.join("mosquitto"))
        .find(|path| path.is_file())
}

/// Returns a name that is unique among tests and runs.
pub(crate) fn unique(name: &str) -> String {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    format!("{name}-{}-{}", std::process::id(), since.as_nanos())
}

fn options(id: &str, port: u16) -> MqttOptions {
    let mut options = MqttOptions::new(id, "127.0.0.1", port);
    let mut properties = ConnectProperties::new();
    properties.max_packet_size = Some(64 << 20);
    options.set_connect_properties(properties).set_keep_alive(Duration::from_secs(5));
    options
}

/// Sends messages with QoS 1, one after the other; the broker has a message when [`send`](Self::send)
/// returns.
pub(crate) struct Sender {
    port: u16,
    client: Client,
    connection: Connection,
}

impl Sender {
    pub(crate) fn connect(port: u16) -> Self {
        let (client, connection) = Client::new(options(&unique("sender"), port), 16);
        Self { port, client, connection }
    }

    pub(crate) fn send(&mut self, topic: &str, payload: &[u8]) {
        self.send_as(topic, payload, None);
    }

    /// Sends with a content type, and with the message's number as correlation data.
    pub(crate) fn send_as(&mut self, topic: &str, payload: &[u8], content_type: Option<&str>) {
        let properties = PublishProperties {
            content_type: content_type.map(str::to_owned),
            correlation_data: Some(topic.as_bytes().to_vec().into()),
            ..PublishProperties::default()
        };
        let began = Instant::now();
        loop {
            let given = self.client.publish_with_properties(
                topic,
                QoS::AtLeastOnce,
                false,
                payload.to_vec(),
                properties.clone(),
            );
            given.unwrap();
            let answered = self.connection.iter().find_map(|event| match event {
                Ok(Event::Incoming(Packet::PubAck(_))) => Some(true),
                Ok(_) => None,
                Err(_) => Some(false),
            });
            if answered == Some(true) {
                return;
            }
            assert!(began.elapsed() < LONGEST, "the broker does not take {topic}");
            std::thread::sleep(Duration::from_millis(100));
            // A connection per attempt, so that an answer belongs to this attempt.
            *self = Self::connect(self.port);
        }
    }
}

/// Collects the messages of a topic filter.
pub(crate) struct Listener {
    received: Arc<Mutex<Vec<(String, Value)>>>,
    client: Client,
}

impl Listener {
    pub(crate) fn connect(port: u16, filter: &str) -> Self {
        let (client, mut connection) = Client::new(options(&unique("listener"), port), 16);
        client.subscribe(filter, QoS::AtLeastOnce).unwrap();
        let received: Arc<Mutex<Vec<_>>> = Arc::default();
        let sink = Arc::clone(&received);
        let (ready, is_ready) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            for event in connection.iter() {
                match event {
                    Ok(Event::Incoming(Packet::SubAck(_))) => ready.send(()).unwrap(),
                    Ok(Event::Incoming(Packet::Publish(publish))) => {
                        let properties = publish.properties.unwrap_or_default();
                        assert_eq!(properties.content_type.as_deref(), Some("application/problem+json"));
                        let topic = String::from_utf8(publish.topic.to_vec()).unwrap();
                        let problem: Value = serde_json::from_slice(&publish.payload).unwrap();
                        let of = properties.correlation_data.unwrap();
                        assert_eq!(Some(&of[..]), problem["topic"].as_str().map(str::as_bytes));
                        sink.lock().unwrap().push((topic, problem));
                    }
                    Ok(_) => {}
                    Err(_) => return,
                }
            }
        });
        is_ready.recv_timeout(LONGEST).unwrap();
        Self { received, client }
    }

    /// Waits for `count` messages.
    pub(crate) fn wait_for(&self, count: usize) -> Vec<(String, Value)> {
        let began = Instant::now();
        loop {
            let received = self.received.lock().unwrap().clone();
            if received.len() >= count {
                return received;
            }
            assert!(began.elapsed() < LONGEST, "{} of {count} messages: {received:?}", received.len());
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        let _ = self.client.disconnect();
    }
}
