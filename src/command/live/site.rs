//! What is served: the page, the state, the curves, the object and the worst views, and the two buttons.

use super::http::{HttpResponse, Request};
use super::live_run::{Copied, LiveRun};
use lobelia::error::stop::{StopSignal, ask_to_stop, is_asked_to_stop};
use lobelia::report::html::data::RunReport;
use lobelia::report::html::text::escaped;
use lobelia::report::html::{SCRIPT, STYLE, filled, sections, views, wipe_dialog};
use lobelia::{Error, Result};
use serde_json::json;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// The page without its data.
const PAGE: &str = include_str!("assets/live.html");
/// Its style and script, after those of a report.
const OWN_STYLE: &str = include_str!("assets/live.css");
const OWN_SCRIPT: &str = include_str!("assets/live.js");
/// The page of an object that is a picture.
const PICTURE: &str = include_str!("assets/picture.html");
/// What can be asked for.
const PATHS: [&str; 7] =
    ["/", "/state.json", "/curves.html", "/views.html", "/object.html", "/renew", "/stop"];
/// What a part of the page may do by itself: nothing.
const FRAGMENT: &str = "default-src 'none'; sandbox";
/// Where the object may be shown; its page says itself what it may do.
const OBJECT: &str = "frame-ancestors 'self'";
/// How long a page waits for the run to come to a step.
const PATIENCE: Duration = Duration::from_secs(20);

/// A page for one run.
pub struct Site {
    shared: Arc<LiveRun>,
    title: String,
    port: u16,
    /// The word that the page's own requests have.
    token: String,
    /// Scripts in the page run only with this.
    nonce: String,
    /// The object and the worst views as they were drawn last.
    object: Mutex<Drawn>,
    views: Mutex<Drawn>,
    /// One thread of its own, so that the run keeps its processors.
    pool: rayon::ThreadPool,
}

/// What was made of a copy, by the copy's number.
type Drawn = Option<(u64, String)>;

impl Site {
    /// A site that is served at `port`.
    ///
    /// # Errors
    /// If the system refuses a thread.
    pub fn new(shared: Arc<LiveRun>, title: String, port: u16) -> Result<Self> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).thread_name(|_| "live".to_owned()).build();
        let pool = pool.map_err(|error| Error::run("the live page", error.to_string()))?;
        let word = || format!("{:032x}", rand::random::<u128>());
        let (object, views) = Default::default();
        Ok(Self { shared, title, port, token: word(), nonce: word(), object, views, pool })
    }

    /// The answer to a request.
    pub fn answer(&self, request: &Request) -> HttpResponse {
        if let Some(refused) = self.refused(request) {
            return refused;
        }
        match (request.method.as_str(), request.path.as_str()) {
            ("GET" | "HEAD", "/") => self.page(),
            ("GET" | "HEAD", "/state.json") => HttpResponse::json(&self.shared.json(is_asked_to_stop())),
            ("GET" | "HEAD", "/curves.html") => HttpResponse::html(self.curves(), FRAGMENT.to_owned()),
            ("GET" | "HEAD", "/views.html") => self.made(&self.views, FRAGMENT, worst_views),
            ("GET" | "HEAD", "/object.html") => {
                self.made(&self.object, OBJECT, |copied| object(copied, &self.title))
            }
            ("POST", "/renew") => self.renew(),
            ("POST", "/stop") => stop(),
            (_, path) if PATHS.contains(&path) => {
                HttpResponse::words(405, "this is asked for in another way")
            }
            _ => HttpResponse::words(404, "there is nothing here"),
        }
    }

    /// Why a request is not answered: it means another host, is of another page, or lacks the word of this one.
    fn refused(&self, request: &Request) -> Option<HttpResponse> {
        let refuse = |words: &str| Some(HttpResponse::words(403, words));
        let hosts = ["127.0.0.1", "localhost"].map(|host| match self.port {
            80 => host.to_owned(),
            port => format!("{host}:{port}"),
        });
        if !hosts.contains(&request.host) {
            return refuse("this page is for 127.0.0.1 alone");
        }
        let own = |origin: &String| hosts.iter().any(|host| origin.strip_prefix("http://") == Some(host));
        if request.origin.as_ref().is_some_and(|origin| !own(origin)) {
            return refuse("another page asks");
        }
        let is_own = |site: &String| site == "same-origin" || site == "none" || request.path == "/";
        if request.site.as_ref().is_some_and(|site| !is_own(site)) {
            return refuse("another page asks");
        }
        let changes = !matches!(request.method.as_str(), "GET" | "HEAD");
        if changes && request.token.as_ref() != Some(&self.token) {
            return refuse("the page's word is missing: load it again");
        }
        None
    }

    fn page(&self) -> HttpResponse {
        let slots = [
            ("{{TITLE}}", escaped(&self.title)),
            ("{{STYLE}}", format!("{STYLE}{OWN_STYLE}")),
            ("{{TOKEN}}", self.token.clone()),
            ("{{HEADING}}", escaped(&self.title)),
            ("{{WIPE}}", wipe_dialog().to_owned()),
            ("{{NONCE}}", self.nonce.clone()),
            ("{{SCRIPT}}", SCRIPT.to_owned()),
            ("{{OWN_NONCE}}", self.nonce.clone()),
            ("{{OWN_SCRIPT}}", OWN_SCRIPT.to_owned()),
        ];
        let policy = format!(
            "default-src 'none'; style-src 'unsafe-inline'; script-src 'nonce-{}'; img-src data:; connect-src 'self'; \
             frame-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
            self.nonce
        );
        filled(PAGE, &slots).map_or_else(|error| failed(&error), |text| HttpResponse::html(text, policy))
    }

    fn curves(&self) -> String {
        sections::curves(&[RunReport { logs: self.shared.logs(), ..RunReport::default() }])
    }

    /// What is made of the newest copy, once of each, by one thread at a time.
    fn made(
        &self,
        drawn: &Mutex<Drawn>,
        policy: &str,
        make: impl FnOnce(&Copied) -> Result<String> + Send,
    ) -> HttpResponse {
        let Some(copied) = self.shared.copy() else {
            return HttpResponse::words(503, "there is no object yet");
        };
        let mut drawn = drawn.lock().unwrap_or_else(PoisonError::into_inner);
        if drawn.as_ref().is_none_or(|(number, _)| *number < copied.number) {
            match self.pool.install(|| make(&copied)) {
                Ok(text) => *drawn = Some((copied.number, text)),
                Err(error) => return failed(&error),
            }
        }
        let text = drawn.as_ref().map_or_else(String::new, |(_, text)| text.clone());
        HttpResponse::html(text, policy.to_owned())
    }

    /// Waits for a copy of the object.
    fn renew(&self) -> HttpResponse {
        let (copied, problem) = self.shared.renewed(PATIENCE);
        let copied = copied.map(|copied| json!({ "number": copied.number, "at": copied.at }));
        HttpResponse::json(&json!({ "copy": copied, "problem": problem }))
    }
}

/// The object's page, or its picture while its surface is a field.
fn object(copied: &Copied, title: &str) -> Result<String> {
    if copied.object.is_field() {
        return filled(PICTURE, &[("{{PICTURE}}", copied.object.picture()?)]);
    }
    copied.object.page(title)
}

fn worst_views(copied: &Copied) -> Result<String> {
    Ok(views::section(&[copied.object.worst_views()?]))
}

/// Does what the first Ctrl-C does; a second press does nothing more.
fn stop() -> HttpResponse {
    let is_first = ask_to_stop(StopSignal::Page);
    HttpResponse::json(&json!({ "first": is_first }))
}

fn failed(error: &Error) -> HttpResponse {
    HttpResponse::words(500, &error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(change: impl FnOnce(&mut Request, &Site)) -> u16 {
        let site = Site::new(Arc::default(), "a <run>".into(), 4000).unwrap();
        let host = "127.0.0.1:4000".to_owned();
        let mut request =
            Request { method: "GET".into(), path: "/state.json".into(), host, ..Request::default() };
        change(&mut request, &site);
        site.answer(&request).status
    }

    #[test]
    fn other_hosts_and_pages_are_refused() {
        assert_eq!(asked(|_, _| ()), 200);
        assert_eq!(asked(|request, _| request.host = "localhost:4000".into()), 200);
        for host in ["", "127.0.0.1", "127.0.0.1:4001", "evil.example:4000", "127.0.0.1:4000.evil.example"] {
            assert_eq!(asked(|request, _| request.host = host.into()), 403, "{host}");
        }
        assert_eq!(asked(|request, _| request.origin = Some("http://127.0.0.1:4000".into())), 200);
        for origin in ["null", "http://evil.example", "https://127.0.0.1:4000", "http://127.0.0.1:4001"] {
            assert_eq!(asked(|request, _| request.origin = Some(origin.into())), 403, "{origin}");
        }
        assert_eq!(asked(|request, _| request.site = Some("same-origin".into())), 200);
        assert_eq!(asked(|request, _| request.site = Some("cross-site".into())), 403);
        // A link to the page is followed.
        assert_eq!(
            asked(|request, _| (request.site, request.path) = (Some("cross-site".into()), "/".into())),
            200
        );
    }

    #[test]
    fn what_changes_something_needs_the_word_of_the_page() {
        let post = |token: Option<&str>| {
            asked(|request, _| {
                (request.method, request.path) = ("POST".into(), "/stop".into());
                request.token = token.map(str::to_owned);
            })
        };
        assert_eq!((post(None), post(Some("")), post(Some("0"))), (403, 403, 403));
        assert_eq!(
            asked(|request, site| {
                (request.method, request.path) = ("DELETE".into(), "/stop".into());
                request.token = Some(site.token.clone());
            }),
            405
        );
        assert_eq!(asked(|request, _| request.path = "/stop".into()), 405);
        assert_eq!(asked(|request, _| request.path = "/../run.json".into()), 404);
        assert_eq!(asked(|request, _| request.path = "/object.html".into()), 503);
        assert!(lobelia::error::stop::stopped_by().is_none());
    }

    #[test]
    fn the_page_is_whole_and_its_title_is_text() {
        let site = Site::new(Arc::default(), "a <run>".into(), 4000).unwrap();
        let response = site.page();
        let text = String::from_utf8(response.body).unwrap();
        assert!(text.contains("a &lt;run&gt;") && !text.contains("{{") && text.contains(&site.token));
        assert!(response.policy.contains(&format!("'nonce-{}'", site.nonce)) && site.nonce != site.token);
        assert!(!text.contains("http://") && !text.contains("https://"), "it loads nothing from elsewhere");
    }
}
