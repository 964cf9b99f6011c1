//! What a person sees on the terminal while a command works: bars, notes, results.

use super::terminal_picture::PictureProtocol;
use indicatif::{ProgressBar, ProgressStyle};
use lobelia::pass::progress::{Bar, Progress};
use lobelia::{Error, Result};
use std::io::{ErrorKind, IsTerminal, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Most bytes of a picture that is sent to a terminal, which may be far away.
const MOST_PICTURE: u64 = 4 << 20;

/// Writes to stdout; a reader that has gone away (`lobelia check … | head -1`) is no failure.
pub fn print(text: &str) -> Result<()> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(Error::io("write", "standard output")(error))
        }
        _ => Ok(()),
    }
}

/// Bars on a terminal and results on standard output; neither under `--quiet`. Errors are printed by the command itself.
pub struct Terminal {
    bars: bool,
    quiet: bool,
}

impl Terminal {
    /// Bars if standard error is a terminal and `quiet` is not set.
    pub fn new(quiet: bool) -> Self {
        Self { bars: !quiet && std::io::stderr().is_terminal(), quiet }
    }
}

impl Progress for Terminal {
    /// On standard error.
    fn note(&self, text: &str) {
        if !self.quiet {
            // A note that nobody can read is no reason to lose a run.
            let _ = writeln!(std::io::stderr().lock(), "note: {text}");
        }
    }

    /// On standard output; a closed pipe is not an error.
    fn print(&self, text: &str) {
        if self.quiet {
            return;
        }
        let mut out = std::io::stdout().lock();
        let _ = writeln!(out, "{text}");
    }

    /// On standard output, if it is a terminal that shows pictures.
    fn picture(&self, path: &Path) {
        let protocol = PictureProtocol::of_terminal(|name| std::env::var(name).ok());
        let shows = !self.quiet && std::io::stdout().is_terminal();
        let Some(protocol) = protocol.filter(|_| shows) else { return };
        let is_small = std::fs::metadata(path).is_ok_and(|found| found.len() <= MOST_PICTURE);
        if let Some(png) = std::fs::read(path).ok().filter(|_| is_small) {
            let _ = write!(std::io::stdout().lock(), "{}", protocol.shown(&png));
        }
    }

    /// With the time left, or that spent where the length is not known; hidden where bars are not shown.
    fn bar(&self, title: &str, length: u64) -> Box<dyn Bar> {
        if !self.bars {
            return Box::new(TerminalBar::new(ProgressBar::hidden()));
        }
        let bar = ProgressBar::new(length);
        dress(&bar, length);
        bar.set_prefix(title.to_owned());
        // The ticker is a thread, and a bar without one is drawn when it moves.
        if std::thread::Builder::new().spawn(|| ()).is_ok() {
            bar.enable_steady_tick(Duration::from_millis(200));
        }
        Box::new(TerminalBar::new(bar))
    }
}

/// Gives a bar the looks of a task of this length.
fn dress(bar: &ProgressBar, length: u64) {
    let template = match length {
        0 => "{prefix:>12} {spinner} {msg} {elapsed}",
        _ => "{prefix:>12} {bar:30} {pos}/{len} {eta:>4} left  {msg}",
    };
    // The templates are fixed; were one wrong, the default style would do.
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.progress_chars("━╸─"));
    }
}

struct TerminalBar {
    bar: ProgressBar,
    /// Whether the number of steps is known now, and none was told yet.
    begins: AtomicBool,
}

impl TerminalBar {
    fn new(bar: ProgressBar) -> Self {
        Self { bar, begins: AtomicBool::new(false) }
    }
}

impl Bar for TerminalBar {
    fn inc(&self, steps: u64) {
        self.bar.inc(steps);
    }

    fn set_position(&self, steps: u64) {
        self.bar.set_position(steps);
        if self.begins.swap(false, Ordering::Relaxed) {
            // Neither the time before the first step nor steps before a break say how long the others take.
            self.bar.tick();
            self.bar.reset_eta();
        }
    }

    fn set_length(&self, steps: u64) {
        if self.bar.length() == Some(0) && steps > 0 {
            dress(&self.bar, steps);
            self.bar.set_message("");
            self.begins.store(true, Ordering::Relaxed);
        }
        self.bar.set_length(steps);
    }

    fn set_message(&self, message: String) {
        self.bar.set_message(message);
    }

    fn finish_and_clear(&self) {
        self.bar.finish_and_clear();
    }
}
