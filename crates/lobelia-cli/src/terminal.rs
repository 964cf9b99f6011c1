//! What a command says while it works: bars, notes and results for a person, or events for
//! programs.

use indicatif::{ProgressBar, ProgressStyle};
use lobelia::progress::{Bar, Progress, Step};
use lobelia::{Error, Result, bevy_ecs::prelude::World};
use serde::Serialize;
use std::io::{ErrorKind, IsTerminal, Write};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Writes to stdout; a reader that has gone away (`lobelia check … | head -1`) is no failure.
pub fn print(text: &str) -> Result<()> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written.map_err(Error::io("write", "standard output")),
    }
}

/// Bars where standard error is a terminal, and results on standard output; neither if it is
/// `quiet`. Errors are printed by the command itself.
pub struct Terminal {
    pub quiet: bool,
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
        if !self.quiet {
            let _ = writeln!(std::io::stdout().lock(), "{text}");
        }
    }

    /// With the time left, or that spent where the length is not known; hidden where bars are not
    /// shown.
    fn bar(&self, title: &str, length: u64) -> Box<dyn Bar> {
        let mut bar = ProgressBar::hidden();
        if !self.quiet && std::io::stderr().is_terminal() {
            bar = ProgressBar::new(length);
            dress(&bar, length);
            bar.set_prefix(title.to_owned());
            // The ticker is a thread, and a bar without one is drawn when it moves.
            if std::thread::Builder::new().spawn(|| ()).is_ok() {
                bar.enable_steady_tick(Duration::from_millis(200));
            }
        }
        Box::new(TerminalBar { bar, begins: AtomicBool::new(false) })
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

impl Bar for TerminalBar {
    fn inc(&self, steps: u64) {
        self.bar.inc(steps);
    }

    fn set_position(&self, steps: u64) {
        self.bar.set_position(steps);
        if self.begins.swap(false, Ordering::Relaxed) {
            // Neither the time before the first step nor steps before a break say how long the
            // others take.
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
}

impl Drop for TerminalBar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Time between two lines about the same task.
const PAUSE: Duration = Duration::from_secs(1);

/// Steps between two lines about a fit.
const STEPS: u32 = 20;

/// What a run says, for programs (`lobelia run --log json`): one JSON object a line on standard
/// output, each with the seconds since the start and the name of an event.
///
/// | event | fields | when |
/// | --- | --- | --- |
/// | `pass` | `name`, `number`, `count` | a pass begins; passes count from 1 |
/// | `stage` | `title`, `length` | a task begins; a `length` of 0 is not known yet |
/// | `progress` | `title`, `done`, `length`, `message` | at most once a second and task of a known length |
/// | `done` | `title`, `done` | the task has ended |
/// | `step` | `step`, `steps`, `loss`, `psnr`, `specular`, `roughness`, `lobes` | every 20 steps of a `Fit` or `Shape`, and its last |
/// | `note`, `result` | `text` | as on the terminal |
/// | `ended` | `state`, `error`, `help` | the last line, but for a second signal: `finished`, `interrupted` or `failed` |
pub struct JsonLog {
    /// When it began.
    pub start: Instant,
}

#[derive(Serialize)]
#[serde(tag = "event", rename_all = "lowercase")]
enum Event<'a> {
    Pass { name: &'a str, number: usize, count: usize },
    Stage { title: &'a str, length: u64 },
    Progress { title: &'a str, done: u64, length: u64, message: &'a str },
    Done { title: &'a str, done: u64 },
    Step { step: u32, steps: u32, loss: f64, psnr: f64, specular: [f32; 3], roughness: f32, lobes: usize },
    Note { text: &'a str },
    Result { text: &'a str },
    Ended { state: &'a str, error: Option<String>, help: Option<&'a str> },
}

#[derive(Serialize)]
struct Line<'a> {
    secs: f64,
    #[serde(flatten)]
    event: Event<'a>,
}

/// Writes a line; whoever reads may be gone, and that is no reason to lose a run.
fn write_event(start: Instant, event: Event) {
    let secs = (start.elapsed().as_secs_f64() * 1000.0).round() / 1000.0;
    if let Ok(text) = serde_json::to_string(&Line { secs, event }) {
        let _ = std::io::stdout().lock().write_all((text + "\n").as_bytes());
    }
}

impl JsonLog {
    /// Says how the run ended.
    pub fn end(&self, ended: &Result<()>) {
        let (state, error) = match ended {
            Ok(()) => ("finished", None),
            Err(error @ Error::Interrupted) => ("interrupted", Some(error)),
            Err(error) => ("failed", Some(error)),
        };
        let help = error.and_then(Error::help);
        let error = error.map(|error| match error {
            Error::Scene(diagnostic) => format!("{}: {error}", diagnostic.name),
            _ => error.to_string(),
        });
        write_event(self.start, Event::Ended { state, error, help });
    }
}

impl Progress for JsonLog {
    fn note(&self, text: &str) {
        write_event(self.start, Event::Note { text });
    }

    fn print(&self, text: &str) {
        write_event(self.start, Event::Result { text });
    }

    fn bar(&self, title: &str, length: u64) -> Box<dyn Bar> {
        write_event(self.start, Event::Stage { title, length });
        let at = Task { done: 0, length, message: String::new(), told: Some(Instant::now()) };
        Box::new(JsonBar { start: self.start, title: title.to_owned(), at: Mutex::new(at) })
    }

    fn pass(&self, name: &str, number: usize, count: usize) {
        write_event(self.start, Event::Pass { name, number, count });
    }

    fn step(&self, at: &Step, _: &mut World) -> Result<ControlFlow<()>> {
        let Step { step, steps, fit, .. } = *at;
        if step.is_multiple_of(STEPS) || step == steps {
            let (loss, psnr, lobes) = (fit.sums.mean(), fit.sums.psnr(), fit.lobes);
            let (specular, roughness) = (fit.specular.albedo.to_array(), fit.specular.roughness);
            write_event(self.start, Event::Step { step, steps, loss, psnr, specular, roughness, lobes });
        }
        Ok(ControlFlow::Continue(()))
    }
}

/// A task, and how far it is.
struct JsonBar {
    start: Instant,
    title: String,
    at: Mutex<Task>,
}

struct Task {
    done: u64,
    length: u64,
    message: String,
    /// When a line told of it; `None` if one is due.
    told: Option<Instant>,
}

impl JsonBar {
    fn change(&self, change: impl FnOnce(&mut Task)) {
        let mut at = self.at.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut at);
        if at.told.is_none_or(|told| told.elapsed() >= PAUSE) {
            at.told = Some(Instant::now());
            let Task { done, length, message, .. } = &*at;
            let (title, done, length) = (self.title.as_str(), *done, *length);
            write_event(self.start, Event::Progress { title, done, length, message });
        }
    }
}

impl Bar for JsonBar {
    fn inc(&self, steps: u64) {
        self.change(|at| at.done += steps);
    }

    fn set_position(&self, steps: u64) {
        self.change(|at| at.done = steps);
    }

    fn set_length(&self, steps: u64) {
        let mut at = self.at.lock().unwrap_or_else(PoisonError::into_inner);
        if at.length == 0 {
            at.message.clear();
        }
        at.length = steps;
    }

    fn set_message(&self, message: String) {
        self.change(|at| {
            // Of a task without a known length it is all that can be said.
            at.told = at.told.filter(|_| at.length > 0);
            at.message = message;
        });
    }
}

impl Drop for JsonBar {
    fn drop(&mut self) {
        let done = self.at.get_mut().unwrap_or_else(PoisonError::into_inner).done;
        write_event(self.start, Event::Done { title: &self.title, done });
    }
}
