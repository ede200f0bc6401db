//! A TCP proxy whose connections can be cut.

use std::io::{Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// A piece that a slow wire forwards, and how long it takes.
const SLOW_BYTES: usize = 16 << 10;
const SLOW: Duration = Duration::from_millis(100);

/// The state of the proxy.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Wire {
    /// Everything is forwarded.
    Whole,
    /// Everything is forwarded, in small pieces and late.
    Slow,
    /// Nothing is forwarded and connections stay open, as with a pulled cable.
    Silent,
    /// All connections are closed, as with a server that is down.
    Closed,
}

/// How a single connection ends.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum End {
    /// Both sides are closed.
    Cut,
    /// Nothing more arrives, and both sides stay open.
    HalfOpen,
}

/// What becomes of a connection: its end, after this many bytes of the client.
type Fate = Option<(usize, End)>;

/// A proxy between a process and a server.
pub(crate) struct Proxy {
    address: SocketAddr,
    wire: Arc<AtomicU8>,
    open: Arc<Mutex<Vec<TcpStream>>>,
    next: Arc<Mutex<Fate>>,
}

impl Proxy {
    pub(crate) fn to(server: SocketAddr) -> Self {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let proxy = Self {
            address: listener.local_addr().unwrap(),
            wire: Arc::new(AtomicU8::new(Wire::Whole as u8)),
            open: Arc::default(),
            next: Arc::default(),
        };
        let (wire, open, next) = (Arc::clone(&proxy.wire), Arc::clone(&proxy.open), Arc::clone(&proxy.next));
        std::thread::spawn(move || {
            for client in listener.incoming().flatten() {
                if wire.load(Ordering::SeqCst) == Wire::Closed as u8 {
                    continue;
                }
                let Ok(server) = TcpStream::connect(server) else {
                    continue;
                };
                let fate = next.lock().unwrap().take();
                let is_half_open = Arc::new(AtomicBool::default());
                let mut open = open.lock().unwrap();
                for (from, to, fate) in [(&client, &server, fate), (&server, &client, None)] {
                    let (from, to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
                    open.push(from.try_clone().unwrap());
                    let direction =
                        Direction { wire: Arc::clone(&wire), is_half_open: Arc::clone(&is_half_open), fate };
                    std::thread::spawn(move || direction.forward(from, to));
                }
            }
        });
        proxy
    }

    pub(crate) fn address(&self) -> SocketAddr {
        self.address
    }

    pub(crate) fn set(&self, wire: Wire) {
        self.wire.store(wire as u8, Ordering::SeqCst);
        if wire == Wire::Closed {
            for connection in self.open.lock().unwrap().drain(..) {
                let _ = connection.shutdown(Shutdown::Both);
            }
        }
    }

    /// Ends the next connection after this many bytes of its client.
    pub(crate) fn end_next_after(&self, bytes: usize, end: End) {
        *self.next.lock().unwrap() = Some((bytes, end));
    }
}

/// One direction of a connection.
struct Direction {
    wire: Arc<AtomicU8>,
    is_half_open: Arc<AtomicBool>,
    fate: Fate,
}

impl Direction {
    fn forward(mut self, mut from: TcpStream, mut to: TcpStream) {
        let mut piece = vec![0; 1 << 16];
        while let Ok(count) = from.read(&mut piece)
            && count > 0
        {
            while self.wire.load(Ordering::SeqCst) == Wire::Silent as u8 {
                std::thread::sleep(Duration::from_millis(10));
            }
            if self.is_half_open.load(Ordering::SeqCst) {
                continue;
            }
            let passed = self.fate.map_or(count, |(bytes, _)| bytes.min(count));
            if self.pass(&mut to, &piece[..passed]).is_err() {
                break;
            }
            match &mut self.fate {
                Some((bytes, _)) if *bytes > count => *bytes -= count,
                Some((_, End::Cut)) => break,
                Some((_, End::HalfOpen)) => {
                    // The other direction ends the connection when the server closes it.
                    self.is_half_open.store(true, Ordering::SeqCst);
                    return;
                }
                None => {}
            }
        }
        for side in [from, to] {
            let _ = side.shutdown(Shutdown::Both);
        }
    }
    fn pass(&self, to: &mut TcpStream, bytes: &[u8]) -> std::io::Result<()> {
        if self.wire.load(Ordering::SeqCst) != Wire::Slow as u8 {
            return to.write_all(bytes);
        }
        bytes.chunks(SLOW_BYTES).try_for_each(|chunk| {
            std::thread::sleep(SLOW);
            to.write_all(chunk)
        })
    }
}
