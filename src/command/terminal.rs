//! What a person sees on the terminal while a command works: bars, notes, results.

use indicatif::{ProgressBar, ProgressStyle};
use lobelia::pass::progress::{Bar, Progress};
use lobelia::{Error, Result};
use std::io::{ErrorKind, IsTerminal, Write};
use std::time::Duration;

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

    /// With the time left, or that spent where the length is not known; hidden where bars are not shown.
    fn bar(&self, title: &str, length: u64) -> Box<dyn Bar> {
        if !self.bars {
            return Box::new(TerminalBar(ProgressBar::hidden()));
        }
        let bar = ProgressBar::new(length);
        dress(&bar, length);
        bar.set_prefix(title.to_owned());
        // The ticker is a thread, and a bar without one is drawn when it moves.
        if std::thread::Builder::new().spawn(|| ()).is_ok() {
            bar.enable_steady_tick(Duration::from_millis(200));
        }
        Box::new(TerminalBar(bar))
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

struct TerminalBar(ProgressBar);

impl Bar for TerminalBar {
    fn inc(&self, steps: u64) {
        self.0.inc(steps);
    }

    fn set_position(&self, steps: u64) {
        self.0.set_position(steps);
    }

    fn set_length(&self, steps: u64) {
        if self.0.length() == Some(0) && steps > 0 {
            // What was spent before the first step says nothing of the steps.
            dress(&self.0, steps);
            self.0.reset();
            self.0.set_message("");
        }
        self.0.set_length(steps);
    }

    fn set_message(&self, message: String) {
        self.0.set_message(message);
    }

    fn finish_and_clear(&self) {
        self.0.finish_and_clear();
    }
}
