//! As much of HTTP as a page on the loopback needs: one request a connection, small and soon, and one answer.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// Bytes of a request, and headers of it, at most.
const MOST_BYTES: usize = 8192;
const MOST_HEADERS: usize = 64;
/// How long a request may take to arrive, and an answer to be taken.
const REQUEST_TIME: Duration = Duration::from_secs(5);
const ANSWER_TIME: Duration = Duration::from_secs(60);
/// Bytes that are written at once.
const CHUNK: usize = 1 << 16;

/// A request without its body, which none here has.
#[derive(Debug, Default, PartialEq)]
pub struct Request {
    /// "GET", "POST", …
    pub method: String,
    /// The path without what follows a question mark.
    pub path: String,
    /// The host that the client means to talk to.
    pub host: String,
    /// The page that a script asks for, if the browser says so.
    pub origin: Option<String>,
    /// Whether that is of this site, if the browser says so.
    pub site: Option<String>,
    /// The word of the page.
    pub token: Option<String>,
}

/// An answer.
pub struct HttpResponse {
    /// 200, 403, …
    pub status: u16,
    /// The kind of text.
    pub kind: &'static str,
    /// What a browser may do with it.
    pub policy: String,
    /// The text.
    pub body: Vec<u8>,
}

impl HttpResponse {
    /// An answer in plain words.
    pub fn words(status: u16, words: &str) -> Self {
        let body = format!("{words}\n").into_bytes();
        Self { status, kind: "text/plain; charset=utf-8", policy: "default-src 'none'".to_owned(), body }
    }

    /// JSON.
    pub fn json(value: &serde_json::Value) -> Self {
        let body = value.to_string().into_bytes();
        Self { status: 200, kind: "application/json", policy: "default-src 'none'".to_owned(), body }
    }

    /// HTML, with what its page may do.
    pub fn html(text: String, policy: String) -> Self {
        Self { status: 200, kind: "text/html; charset=utf-8", policy, body: text.into_bytes() }
    }
}

/// Reads a request; `None` if the client has gone, or takes too long. `Err` is the answer to one that is none.
pub fn read_request(stream: &mut TcpStream) -> Option<Result<Request, HttpResponse>> {
    let begun = Instant::now();
    let (mut bytes, mut filled) = (vec![0; MOST_BYTES], 0);
    loop {
        let left = REQUEST_TIME.checked_sub(begun.elapsed()).filter(|left| !left.is_zero())?;
        stream.set_read_timeout(Some(left)).ok()?;
        match stream.read(&mut bytes[filled..]).ok()? {
            0 => return None,
            count => filled += count,
        }
        match parsed(&bytes[..filled]) {
            Ok(Some(request)) => return Some(Ok(request)),
            Ok(None) if filled < MOST_BYTES => {}
            Ok(None) => return Some(Err(HttpResponse::words(431, "the request is too large"))),
            Err(answer) => return Some(Err(answer)),
        }
    }
}

/// The request in these bytes; `None` if it is not whole.
fn parsed(bytes: &[u8]) -> Result<Option<Request>, HttpResponse> {
    let mut headers = [httparse::EMPTY_HEADER; MOST_HEADERS];
    let mut found = httparse::Request::new(&mut headers);
    match found.parse(bytes) {
        Ok(status) if status.is_partial() => return Ok(None),
        Ok(_) => {}
        Err(httparse::Error::TooManyHeaders) => {
            return Err(HttpResponse::words(431, "the request has too many headers"));
        }
        Err(error) => return Err(HttpResponse::words(400, &format!("this is no request: {error}"))),
    }
    let path = found.path.unwrap_or_default();
    let mut request = Request {
        method: found.method.unwrap_or_default().to_owned(),
        path: path.split('?').next().unwrap_or_default().to_owned(),
        ..Request::default()
    };
    for header in found.headers.iter() {
        let value = String::from_utf8_lossy(header.value).trim().to_owned();
        match header.name.to_ascii_lowercase().as_str() {
            "host" => request.host = value,
            "origin" => request.origin = Some(value),
            "sec-fetch-site" => request.site = Some(value),
            "x-lobelia-token" => request.token = Some(value),
            _ => {}
        }
    }
    Ok(Some(request))
}

/// Writes an answer. A client that has gone, or takes too long, is left.
pub fn write_response(stream: &mut TcpStream, response: &HttpResponse, with_body: bool) {
    let HttpResponse { status, kind, policy, body } = response;
    let head = format!(
        "HTTP/1.1 {status} {}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nContent-Security-Policy: {policy}\r\n\
         X-Content-Type-Options: nosniff\r\nCross-Origin-Resource-Policy: same-origin\r\nReferrer-Policy: no-referrer\r\n\
         Cache-Control: no-store\r\nConnection: close\r\n\r\n",
        reason(*status),
        body.len()
    );
    let begun = Instant::now();
    let body = if with_body { body.as_slice() } else { &[] };
    for chunk in std::iter::once(head.as_bytes()).chain(body.chunks(CHUNK)) {
        let Some(left) = ANSWER_TIME.checked_sub(begun.elapsed()).filter(|left| !left.is_zero()) else {
            return;
        };
        // Whoever does not read is not answered.
        if stream.set_write_timeout(Some(left)).and_then(|()| stream.write_all(chunk)).is_err() {
            return;
        }
    }
}

fn reason(status: u16) -> &'static str {
    match status {
        200 => "OK",
        400 => "Bad Request",
        403 => "Forbidden",
        404 => "Not Found",
        405 => "Method Not Allowed",
        431 => "Request Header Fields Too Large",
        503 => "Service Unavailable",
        _ => "Internal Server Error",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_read_and_what_is_none_is_refused() {
        let text =
            b"POST /stop?x=1 HTTP/1.1\r\nHost: 127.0.0.1:80\r\nORIGIN: null\r\nx-lobelia-token: abc\r\n\r\n";
        let request = parsed(text).ok().flatten().unwrap();
        assert_eq!((request.method.as_str(), request.path.as_str()), ("POST", "/stop"));
        assert_eq!((request.host.as_str(), request.origin.as_deref()), ("127.0.0.1:80", Some("null")));
        assert_eq!((request.token.as_deref(), request.site), (Some("abc"), None));
        assert!(matches!(parsed(b"GET / HTTP/1.1\r\nHost: x\r\n"), Ok(None)));
        let status = |text: &[u8]| parsed(text).err().map(|answer| answer.status);
        assert_eq!(status(b"\x16\x03\x01\x02\x00\x01\x00"), Some(400));
        let many = format!("GET / HTTP/1.1\r\n{}\r\n", "a: b\r\n".repeat(65));
        assert_eq!(status(many.as_bytes()), Some(431));
    }
}
