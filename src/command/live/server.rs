//! The server: one thread that listens on the loopback, and one for each client for as long as a request takes.

use super::http::{read_request, write_response};
use super::site::Site;
use lobelia::{Error, Result};
use std::io::ErrorKind;
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Clients at once; others are turned away.
const MOST_CLIENTS: usize = 16;
/// How long the server waits where the system has no room for a client.
const PAUSE: Duration = Duration::from_millis(100);

/// Takes a port of the loopback; 0 is any that is free. Returns which.
pub fn listen(port: u16) -> Result<(TcpListener, u16)> {
    let refused = |error: std::io::Error| {
        let problem = match error.kind() {
            ErrorKind::AddrInUse => format!("port {port} of 127.0.0.1 is in use"),
            _ => format!("port {port} of 127.0.0.1 cannot be taken: {error}"),
        };
        Error::usage(problem, "Give `--live` another port, or none for one that is free.")
    };
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(refused)?;
    let port = listener.local_addr().map_err(refused)?.port();
    Ok((listener, port))
}

/// Serves a site from now on, until the process ends.
pub fn serve(listener: TcpListener, site: Site) -> Result<()> {
    let (site, clients) = (Arc::new(site), Arc::new(AtomicUsize::new(0)));
    let listening = move || {
        for stream in listener.incoming() {
            match stream {
                Ok(stream) => admit(stream, &site, &clients),
                Err(_) => std::thread::sleep(PAUSE),
            }
        }
    };
    let started = std::thread::Builder::new().name("live".into()).spawn(listening);
    started.map(drop).map_err(|error| Error::run("the live page", error.to_string()))
}

/// A client's place among those at once.
struct Seat(Arc<AtomicUsize>);

impl Drop for Seat {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

fn admit(stream: TcpStream, site: &Arc<Site>, clients: &Arc<AtomicUsize>) {
    let others = clients.fetch_add(1, Ordering::Relaxed);
    let seat = Seat(clients.clone());
    if others >= MOST_CLIENTS {
        return;
    }
    let site = site.clone();
    let client = move || {
        let _seat = seat;
        talk(stream, &site);
    };
    // Without room for a thread the client is turned away.
    let _ = std::thread::Builder::new().name("live client".into()).spawn(client);
}

fn talk(mut stream: TcpStream, site: &Site) {
    let (response, with_body) = match read_request(&mut stream) {
        None => return,
        Some(Err(response)) => (response, true),
        Some(Ok(request)) => (site.answer(&request), request.method != "HEAD"),
    };
    write_response(&mut stream, &response, with_body);
}
