//! Live streams over a WebSocket.

use std::time::{Duration, Instant};

use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade};
use axum::response::Response;
use bytes::Bytes;
use futures_util::FutureExt;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use tokio::sync::watch;

use super::{CHECK_INTERVAL, OpenStream, refresh};
use crate::http::access::TokenWatch;
use crate::http::access::session::Caller;
use crate::http::app::App;
use crate::recording::json_error_words;
use crate::recording::stream::Chunk;
use crate::service::Pulses;
use crate::service::{ServiceError, StreamGap, StreamProgress, StreamSender};
use crate::signal::OperatingPoint;
use crate::store::StoreError;

/// Maximum size of one message in bytes.
const MAX_MESSAGE_BYTES: usize = 4 << 20;

/// Maximum number of bytes stored together: one disk sync serves them all.
const MAX_BATCH_BYTES: usize = 4 << 20;

/// Size of the index and time before the samples of a message.
const HEAD_BYTES: usize = 16;

/// Silence after which the sender is pinged, and after which it counts as gone.
const PING_AFTER: Duration = Duration::from_secs(15);
const GONE_AFTER: Duration = Duration::from_secs(45);

/// A control message of a sender, by its `type`.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
enum ClientMessage {
    /// No samples before this index will follow.
    Gap { next: u64 },
    /// The machine's operating point from now on.
    Operating { shaft_speed_hz: Option<f64>, torque_nm: Option<f64>, temperature_c: Option<f64> },
    /// Tachometer pulses within future samples, as offsets from an index.
    Tachometer {
        from: u64,
        pulses: Vec<f64>,
        #[serde(default = "one")]
        pulses_per_revolution: u32,
    },
    /// The stream ends for now.
    End {},
}

fn one() -> u32 {
    1
}

impl ClientMessage {
    /// Reads a message; an error names the field at fault.
    fn parse(text: &str) -> Result<Self, String> {
        let mut fields: Map<String, Value> = serde_json::from_str(text).map_err(|error| error.to_string())?;
        let kind = match fields.remove("type") {
            Some(Value::String(kind)) => kind,
            Some(other) => return Err(format!("type is {other}, expected the name of a message")),
            None => return Err("missing field `type`".to_owned()),
        };
        // A field within a tagged enum has no path, unlike one of the value of a tag.
        let message = json!({ kind.as_str(): fields });
        serde_path_to_error::deserialize(message).map_err(|error| {
            let path = error.path().to_string();
            match path.strip_prefix(&kind).and_then(|path| path.strip_prefix('.')) {
                Some(path) => format!("{path}: {}", json_error_words(error.inner())),
                None => json_error_words(error.inner()),
            }
        })
    }
}

/// A message to a sender.
#[derive(Debug, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
enum ServerMessage {
    /// The index to continue with.
    Stream { next: Option<u64> },
    /// Everything before this index is stored.
    Ack { next: Option<u64> },
    /// Missing samples.
    Gap { first: u64, samples: u64 },
}

/// The reason and code for closing a connection.
struct Closing {
    code: u16,
    reason: String,
}

impl Closing {
    fn new(code: u16, reason: impl Into<String>) -> Self {
        Self { code, reason: reason.into() }
    }

    fn end() -> Self {
        Self::new(1000, "the stream has ended")
    }
}

impl From<ServiceError> for Closing {
    fn from(error: ServiceError) -> Self {
        let code = match &error {
            ServiceError::Recording(_)
            | ServiceError::Field { .. }
            | ServiceError::StreamRestarted { .. } => 4400,
            ServiceError::Store(StoreError::AssetUnknown(_)) | ServiceError::StreamUnknown { .. } => 4404,
            ServiceError::StreamTaken => 4409,
            ServiceError::Store(error) if error.is_full() => 4507,
            ServiceError::Busy { .. } => 4503,
            ServiceError::Store(error) if error.is_unavailable() => 4503,
            _ => {
                tracing::error!(%error, "stream failed");
                1011
            }
        };
        Self::new(code, error.to_string())
    }
}

/// Upgrades a request that starts a stream to a WebSocket.
pub(crate) fn upgrade(
    request: WebSocketUpgrade,
    app: App,
    stream: OpenStream,
    caller: Option<Caller>,
) -> Response {
    let request = request.max_message_size(MAX_MESSAGE_BYTES).max_frame_size(MAX_MESSAGE_BYTES);
    request.on_upgrade(async move |socket| {
        let over = app.service.streams.watch_end();
        let OpenStream { sender, permit: _permit } = stream;
        let token = TokenWatch::new(app.access, caller);
        let connection = Connection { token, sender, over, checked_at: Instant::now() };
        connection.run(socket).await;
    })
}

struct Connection {
    token: TokenWatch,
    sender: StreamSender,
    over: watch::Receiver<bool>,
    checked_at: Instant,
}

impl Connection {
    async fn run(mut self, mut socket: WebSocket) {
        let Err(closing) = self.serve(&mut socket).await else { return };
        tracing::debug!(code = closing.code, reason = closing.reason, "stream closed");
        let mut reason = closing.reason;
        // The maximum that fits into the frame
        while reason.len() > 123 {
            reason.pop();
        }
        let frame = CloseFrame { code: closing.code, reason: reason.into() };
        let farewell = async {
            let _ = socket.send(Message::Close(Some(frame))).await;
            // Wait for the response of the client, which shows that it has read the reason
            while let Some(Ok(message)) = socket.recv().await {
                if matches!(message, Message::Close(_)) {
                    break;
                }
            }
        };
        let _ = tokio::time::timeout(Duration::from_secs(5), farewell).await;
    }

    /// Receives messages until the connection ends (`Ok`) or must be closed.
    async fn serve(&mut self, socket: &mut WebSocket) -> Result<(), Closing> {
        if !send_message(socket, &ServerMessage::Stream { next: self.sender.next() }).await {
            return Ok(());
        }
        let (mut received_at, mut is_pinged) = (Instant::now(), false);
        loop {
            let received = tokio::select! {
                _ = self.over.wait_for(|over| *over) => {
                    return Err(Closing::new(1001, "the service is stopping: continue when it is back"));
                }
                () = self.sender.taken_over() => return Err(ServiceError::StreamTaken.into()),
                received = tokio::time::timeout(CHECK_INTERVAL, socket.recv()) => received,
            };
            if self.token.is_revoked().await {
                return Err(Closing::new(4401, "the token was revoked"));
            }
            if self.checked_at.elapsed() >= CHECK_INTERVAL {
                self.checked_at = Instant::now();
                refresh(&mut self.sender).await?;
            }
            match received {
                Ok(Some(Ok(message))) => {
                    (received_at, is_pinged) = (Instant::now(), false);
                    if !self.handle(socket, message).await? {
                        return Ok(());
                    }
                }
                Ok(Some(Err(error))) => {
                    return Err(Closing::new(1002, format!("failed to read the message: {error}")));
                }
                Ok(None) => return Ok(()),
                Err(_) if received_at.elapsed() >= GONE_AFTER => {
                    return Err(Closing::new(4408, "nothing received for 45 s, not even a pong"));
                }
                Err(_) if received_at.elapsed() >= PING_AFTER && !is_pinged => {
                    is_pinged = true;
                    if socket.send(Message::Ping(Bytes::new())).await.is_err() {
                        return Ok(());
                    }
                }
                Err(_) => {}
            }
        }
    }

    /// Handles a message together with further ones already received; false if the connection has ended.
    async fn handle(&mut self, socket: &mut WebSocket, message: Message) -> Result<bool, Closing> {
        let mut next = Some(message);
        let (mut chunks, mut bytes) = (Vec::new(), 0);
        let mut ended = None;
        while let Some(message) = next.take() {
            match message {
                Message::Binary(message) => {
                    bytes += message.len();
                    match self.chunk(message) {
                        Ok(chunk) => chunks.push(chunk),
                        Err(closing) => ended = Some(closing),
                    }
                }
                Message::Text(text) => {
                    // Samples received before a control message precede it
                    if !self.store(socket, std::mem::take(&mut chunks)).await? {
                        return Ok(false);
                    }
                    match self.handle_control(socket, text.as_str()).await {
                        Ok(true) => {}
                        Ok(false) => return Ok(false),
                        Err(closing) => ended = Some(closing),
                    }
                }
                Message::Close(_) => {
                    self.store(socket, chunks).await?;
                    return Ok(false);
                }
                Message::Ping(_) | Message::Pong(_) => {}
            }
            if ended.is_some() || bytes >= MAX_BATCH_BYTES {
                break;
            }
            // Errors are reported again by the next call
            if let Some(Some(Ok(message))) = socket.recv().now_or_never() {
                next = Some(message);
            }
        }
        let is_open = self.store(socket, chunks).await?;
        ended.map_or(Ok(is_open), Err)
    }

    /// Stores chunks and acknowledges them; false if the connection has ended.
    async fn store(&mut self, socket: &mut WebSocket, chunks: Vec<Chunk>) -> Result<bool, Closing> {
        if chunks.is_empty() {
            return Ok(true);
        }
        let StreamProgress { next, gaps } = self.sender.take(chunks).await?;
        Ok(send_gaps(socket, &gaps).await && send_message(socket, &ServerMessage::Ack { next }).await)
    }

    async fn handle_control(&mut self, socket: &mut WebSocket, text: &str) -> Result<bool, Closing> {
        let message = ClientMessage::parse(text);
        match message.map_err(|error| Closing::new(4400, format!("invalid message: {error}")))? {
            ClientMessage::Gap { next } => {
                let StreamProgress { next, gaps } = self.sender.declare_lost_before(next).await?;
                Ok(send_gaps(socket, &gaps).await && send_message(socket, &ServerMessage::Ack { next }).await)
            }
            ClientMessage::Operating { shaft_speed_hz, torque_nm, temperature_c } => {
                let point = OperatingPoint { shaft_speed_hz, torque_nm, temperature_c };
                self.sender.set_operating_point(point).await?;
                Ok(true)
            }
            ClientMessage::Tachometer { from, pulses, pulses_per_revolution } => {
                let pulses = Pulses::new(from, &pulses, pulses_per_revolution)?;
                self.sender.take_pulses(pulses).await?;
                Ok(true)
            }
            ClientMessage::End {} => Err(Closing::end()),
        }
    }

    /// Parses the samples of a message.
    fn chunk(&self, mut message: Bytes) -> Result<Chunk, Closing> {
        let (head, _) = message.as_chunks::<8>();
        let [first, time_ns, ..] = head else {
            let reason =
                format!("the message has {} bytes, expected an index, a time and samples", message.len());
            return Err(Closing::new(4400, reason));
        };
        let (first, time_ns) = (u64::from_le_bytes(*first), i64::from_le_bytes(*time_ns));
        let bytes = message.split_off(HEAD_BYTES);
        let mut chunk = self.sender.received_now(first, bytes);
        if time_ns != 0 {
            chunk.time_ns = Some(time_ns);
            self.sender.check_repeat(&chunk)?;
        }
        Ok(chunk)
    }
}

async fn send_gaps(socket: &mut WebSocket, gaps: &[StreamGap]) -> bool {
    for gap in gaps {
        if !send_message(socket, &ServerMessage::Gap { first: gap.first, samples: gap.samples }).await {
            return false;
        }
    }
    true
}

/// Sends a message; false if the connection has ended.
async fn send_message(socket: &mut WebSocket, message: &ServerMessage) -> bool {
    // A structure of numbers and names always serialises
    let text = serde_json::to_string(message).unwrap_or_default();
    socket.send(Message::Text(text.into())).await.is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_invalid_message_names_the_field() {
        for (text, words) in [
            (
                r#"{"type":"operating","torque_nm":"5"}"#,
                "torque_nm: invalid type: string \"5\", expected a number",
            ),
            (r#"{"type":"tachometer","from":0,"pulses":[1,"2"]}"#, "pulses[1]: invalid type"),
            (r#"{"type":"gap","next":-1}"#, "next: invalid value: integer `-1`"),
            (r#"{"type":"gap"}"#, "missing field `next`"),
            (r#"{"type":"operating","speed":3}"#, "unknown field `speed`, expected one of `shaft_speed_hz`"),
            (r#"{"type":"end","x":1}"#, "unknown field `x`"),
            (r#"{"type":"dance"}"#, "unknown variant `dance`, expected one of `gap`, `operating`"),
            (r#"{"type":5}"#, "type is 5, expected"),
            (r#"{"next":5}"#, "missing field `type`"),
            ("{", "EOF"),
        ] {
            let error = ClientMessage::parse(text).unwrap_err();
            assert!(error.contains(words), "{text}: {error}");
        }
        let end = ClientMessage::parse(r#"{"type":"end"}"#);
        assert!(matches!(end, Ok(ClientMessage::End {})), "{end:?}");
    }
}
