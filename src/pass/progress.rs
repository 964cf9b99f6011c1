//! What the terminal shows while passes run: bars on a terminal, nothing under `--quiet` or in a pipe but the results.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::time::Duration;

/// The terminal's side of a run.
pub struct Progress {
    bars: bool,
    quiet: bool,
}

impl Progress {
    /// Bars if standard error is a terminal and `quiet` is not set.
    pub fn new(quiet: bool) -> Self {
        Self { bars: !quiet && std::io::stderr().is_terminal(), quiet }
    }

    /// A bar of `length` steps with the time left; hidden where bars are not shown.
    pub fn bar(&self, title: &str, length: u64) -> ProgressBar {
        if !self.bars {
            return ProgressBar::hidden();
        }
        let bar = ProgressBar::new(length);
        // The template is fixed; were it wrong, the default style would do.
        if let Ok(style) =
            ProgressStyle::with_template("{prefix:>12} {bar:30} {pos}/{len} {eta:>4} left  {msg}")
        {
            bar.set_style(style.progress_chars("━╸─"));
        }
        bar.set_prefix(title.to_owned());
        bar.enable_steady_tick(Duration::from_millis(200));
        bar
    }

    /// Something worth knowing that is not an error.
    pub fn note(&self, text: &str) {
        if !self.quiet {
            eprintln!("note: {text}");
        }
    }

    /// A line of result on standard output; a closed pipe is not an error.
    pub fn print(&self, text: &str) {
        let mut out = std::io::stdout().lock();
        let _ = writeln!(out, "{text}");
    }
}
