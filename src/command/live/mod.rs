//! `lobelia run --live`: a page on the loopback that shows the run while it works, with a button that stops it.
//!
//! | file | holds |
//! | --- | --- |
//! | [`live_run`] | what the run says and the server reads |
//! | [`server`], [`http`] | the server: threads, requests, answers |
//! | [`site`] | what is served, and to whom |
//! | `assets/` | the page |
//!
//! The run notes where it is at each step, and copies the object at the next one when a page asks. Server and drawing have threads of
//! their own, which see neither the world nor its systems. What goes wrong there never ends the run.

mod http;
mod live_run;
mod server;
mod site;

use live_run::{BarAt, LiveRun};
use lobelia::pass::progress::{Bar, Copier, Moment, Progress};
use lobelia::{Error, Result};
use site::Site;
use std::io::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// What shows the run without a page, and the page beside it.
pub struct Live<'a> {
    shown: &'a dyn Progress,
    shared: Arc<LiveRun>,
    bars: AtomicU64,
}

impl<'a> Live<'a> {
    /// Serves a page about the run into `out` at `port` (0: any that is free) from now on, and says where.
    pub fn start(port: u16, out: &Path, shown: &'a dyn Progress) -> Result<Self> {
        let (listener, port) = server::listen(port)?;
        let shared = Arc::new(LiveRun::default());
        let title =
            out.file_name().map_or_else(|| "run".to_owned(), |name| name.to_string_lossy().into_owned());
        server::serve(listener, Site::new(shared.clone(), title, port)?)?;
        // Also with --quiet: without the address there is no page. In one piece, for a program that waits for it.
        let address = format!("live: http://127.0.0.1:{port}/\n");
        let _ = std::io::stderr().lock().write_all(address.as_bytes());
        Ok(Self { shown, shared, bars: AtomicU64::new(1) })
    }

    /// Tells the page how the run ended.
    pub fn end(&self, ended: &Result<()>) {
        self.shared.end(match ended {
            Ok(()) => "finished",
            Err(Error::Interrupted) => "interrupted",
            Err(_) => "failed",
        });
    }
}

impl Progress for Live<'_> {
    fn note(&self, text: &str) {
        self.shared.say(text);
        self.shown.note(text);
    }

    fn print(&self, text: &str) {
        self.shared.say(text);
        self.shown.print(text);
    }

    fn picture(&self, path: &Path) {
        self.shown.picture(path);
    }

    fn bar(&self, title: &str, length: u64) -> Box<dyn Bar> {
        let id = self.bars.fetch_add(1, Ordering::Relaxed);
        self.shared.show_bar(BarAt { id, title: title.to_owned(), length, ..BarAt::default() });
        Box::new(LiveBar { id, shown: self.shown.bar(title, length), shared: self.shared.clone() })
    }

    fn look(&self, at: Moment, copy: &mut Copier) {
        self.shared.look(at, copy);
        self.shown.look(at, copy);
    }
}

/// A bar, and the same on the page.
struct LiveBar {
    id: u64,
    shown: Box<dyn Bar>,
    shared: Arc<LiveRun>,
}

impl Bar for LiveBar {
    fn inc(&self, steps: u64) {
        self.shared.on_bar(self.id, |bar| bar.position += steps);
        self.shown.inc(steps);
    }

    fn set_position(&self, steps: u64) {
        self.shared.on_bar(self.id, |bar| bar.position = steps);
        self.shown.set_position(steps);
    }

    fn set_length(&self, steps: u64) {
        self.shared.on_bar(self.id, |bar| {
            if bar.length == 0 {
                bar.message.clear();
            }
            bar.length = steps;
        });
        self.shown.set_length(steps);
    }

    fn set_message(&self, message: String) {
        self.shared.on_bar(self.id, |bar| bar.message.clone_from(&message));
        self.shown.set_message(message);
    }

    fn finish_and_clear(&self) {
        self.shared.hide_bar(self.id);
        self.shown.finish_and_clear();
    }
}

impl Drop for LiveBar {
    fn drop(&mut self) {
        self.shared.hide_bar(self.id);
    }
}
