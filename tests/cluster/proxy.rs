//! A TCP proxy whose connections can be cut.

use std::io::{Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// The state of the proxy.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Wire {
    /// Everything is forwarded.
    Whole,
    /// Nothing is forwarded and connections stay open, as with a pulled cable.
    Silent,
    /// All connections are closed, as with a server that is down.
    Closed,
}

/// A proxy between a process and a server.
pub(super) struct Proxy {
    address: SocketAddr,
    wire: Arc<AtomicU8>,
    open: Arc<Mutex<Vec<TcpStream>>>,
}

impl Proxy {
    pub(super) fn to(server: SocketAddr) -> Self {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let proxy = Self {
            address: listener.local_addr().unwrap(),
            wire: Arc::new(AtomicU8::new(Wire::Whole as u8)),
            open: Arc::default(),
        };
        let (wire, open) = (Arc::clone(&proxy.wire), Arc::clone(&proxy.open));
        std::thread::spawn(move || {
            for client in listener.incoming().flatten() {
                if wire.load(Ordering::SeqCst) == Wire::Closed as u8 {
                    continue;
                }
                let Ok(server) = TcpStream::connect(server) else {
                    continue;
                };
                let mut open = open.lock().unwrap();
                for (from, to) in [(&client, &server), (&server, &client)] {
                    let (from, to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
                    open.push(from.try_clone().unwrap());
                    let wire = Arc::clone(&wire);
                    std::thread::spawn(move || copy(from, to, &wire));
                }
            }
        });
        proxy
    }

    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }

    pub(super) fn set(&self, wire: Wire) {
        self.wire.store(wire as u8, Ordering::SeqCst);
        if wire == Wire::Closed {
            for connection in self.open.lock().unwrap().drain(..) {
                let _ = connection.shutdown(Shutdown::Both);
            }
        }
    }
}

fn copy(mut from: TcpStream, mut to: TcpStream, wire: &AtomicU8) {
    let mut piece = vec![0; 1 << 16];
    while let Ok(count) = from.read(&mut piece)
        && count > 0
    {
        while wire.load(Ordering::SeqCst) == Wire::Silent as u8 {
            std::thread::sleep(Duration::from_millis(10));
        }
        if to.write_all(&piece[..count]).is_err() {
            break;
        }
    }
    let _ = to.shutdown(Shutdown::Both);
}
