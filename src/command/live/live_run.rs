//! What the run says and the server reads: one struct under one lock. Neither waits for the other longer than that takes.

use lobelia::pass::live::Snapshot;
use lobelia::pass::progress::{Copier, Moment};
use lobelia::report::html::data::FitLog;
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Lines of the run that are kept, and characters of one.
const MOST_LINES: usize = 200;
const LONGEST_LINE: usize = 2000;
/// Steps between two points of a curve, and points of one, at first.
const LOG_EVERY: u32 = 20;
const MOST_POINTS: usize = 2000;
/// How long the end of a run waits for a page that is open to ask how it ended.
const LAST_WORD: Duration = Duration::from_millis(1500);
/// The columns of a log, as `log.csv` has them.
const COLUMNS: [&str; 9] =
    ["step", "elapsed_secs", "loss", "psnr", "specular_r", "specular_g", "specular_b", "roughness", "lobes"];

/// The object as it was at a step.
pub struct Copied {
    /// The copies are counted from 1.
    pub number: u64,
    /// The pass and step, in words.
    pub at: String,
    /// The object.
    pub object: Snapshot,
}

/// A run, as the page shows it.
pub struct LiveRun {
    begun: Instant,
    state: Mutex<State>,
    /// Told when there is a new copy, and when the run ends.
    changed: Condvar,
    /// Whether a page has asked for a copy.
    wanted: AtomicBool,
}

#[derive(Default)]
struct State {
    ended: Option<String>,
    pass: Option<PassAt>,
    step: Option<StepAt>,
    bar: Option<BarAt>,
    lines: VecDeque<String>,
    logs: Vec<FitLog>,
    log_every: u32,
    copy: Option<Arc<Copied>>,
    /// Why there is no newer copy.
    problem: Option<String>,
    /// When a page asked last, and whether it has been told of the end.
    asked: Option<Instant>,
    told: bool,
}

struct PassAt {
    name: String,
    number: usize,
    count: usize,
    begun: Instant,
}

#[derive(Clone, Copy)]
struct StepAt {
    level: [usize; 2],
    step: [u32; 2],
    psnr: f64,
    loss: f64,
    roughness: f32,
}

/// A bar as the terminal would show it.
#[derive(Clone, Default)]
pub struct BarAt {
    /// Number of the bar.
    pub id: u64,
    /// What is done.
    pub title: String,
    /// Steps that are done, and all.
    pub position: u64,
    /// All steps.
    pub length: u64,
    /// What stands beside it.
    pub message: String,
}

impl Default for LiveRun {
    fn default() -> Self {
        let (state, changed, wanted) = (Mutex::default(), Condvar::new(), AtomicBool::new(false));
        Self { begun: Instant::now(), state, changed, wanted }
    }
}

impl LiveRun {
    /// A thread that panicked has left nothing half done here.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes a line that the run tells.
    pub fn say(&self, text: &str) {
        let mut state = self.lock();
        for line in text.lines() {
            state.lines.push_back(line.chars().take(LONGEST_LINE).collect());
        }
        let extra = state.lines.len().saturating_sub(MOST_LINES);
        state.lines.drain(..extra);
    }

    /// Changes the bar of this number, if it is the one that is shown.
    pub fn on_bar(&self, id: u64, change: impl FnOnce(&mut BarAt)) {
        if let Some(bar) = self.lock().bar.as_mut().filter(|bar| bar.id == id) {
            change(bar);
        }
    }

    /// Shows a bar in place of the one before.
    pub fn show_bar(&self, bar: BarAt) {
        self.lock().bar = Some(bar);
    }

    /// Takes a bar away, if it is still the one that is shown.
    pub fn hide_bar(&self, id: u64) {
        let mut state = self.lock();
        if state.bar.as_ref().is_some_and(|bar| bar.id == id) {
            state.bar = None;
        }
    }

    /// Notes where the run is, and copies the object if a page has asked for it.
    pub fn look(&self, at: Moment, copy: &mut Copier) {
        self.lock().note(at);
        if !self.wanted.swap(false, Ordering::Relaxed) {
            return;
        }
        let before = self.lock().copy.clone();
        let copied = copy(before.as_ref().map(|before| &before.object));
        let mut state = self.lock();
        match copied {
            Ok(object) => {
                let number = before.map_or(0, |before| before.number) + 1;
                state.copy = Some(Arc::new(Copied { number, at: state.words(), object }));
                state.problem = None;
            }
            Err(error) => {
                state.problem = Some(error.to_string());
                // Before its first step a run has nothing to show, and soon it has.
                self.wanted.store(matches!(at, Moment::Pass { .. }), Ordering::Relaxed);
            }
        }
        drop(state);
        self.changed.notify_all();
    }

    /// Asks for a copy and waits for it until the run comes to its next step. Returns the newest one, and why it is not newer.
    pub fn renewed(&self, patience: Duration) -> (Option<Arc<Copied>>, Option<String>) {
        let state = self.lock();
        let number = |state: &State| state.copy.as_ref().map_or(0, |copy| copy.number);
        let before = number(&state);
        self.wanted.store(true, Ordering::Relaxed);
        let waits = |state: &mut State| number(state) == before && state.ended.is_none();
        let waited = self.changed.wait_timeout_while(state, patience, waits);
        let (state, waited) = waited.unwrap_or_else(PoisonError::into_inner);
        let no_step = || "The run comes to no step now; the object is copied at the next one.".to_owned();
        let problem = state.problem.clone().or_else(|| waited.timed_out().then(no_step));
        (state.copy.clone(), problem)
    }

    /// The newest copy that there is.
    pub fn copy(&self) -> Option<Arc<Copied>> {
        self.lock().copy.clone()
    }

    /// The curves so far.
    pub fn logs(&self) -> Vec<FitLog> {
        self.lock().logs.clone()
    }

    /// The run has ended. A page that is open gets a moment to ask how.
    pub fn end(&self, how: &str) {
        let mut state = self.lock();
        state.ended = Some(how.to_owned());
        self.changed.notify_all();
        if state.asked.is_some_and(|asked| asked.elapsed() < 2 * LAST_WORD) {
            let waited = self.changed.wait_timeout_while(state, LAST_WORD, |state| !state.told);
            drop(waited);
            // The answer is on its way.
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// The state for the page; `stopping` says whether the run has been asked to stop.
    pub fn json(&self, stopping: bool) -> Value {
        let mut state = self.lock();
        state.asked = Some(Instant::now());
        if state.ended.is_some() {
            state.told = true;
            self.changed.notify_all();
        }
        let running = if stopping { "stopping" } else { "running" };
        let pass = state.pass.as_ref().map(|pass| {
            json!({
                "name": pass.name, "number": pass.number, "count": pass.count,
                "secs": pass.begun.elapsed().as_secs_f64(),
            })
        });
        let step = state.step.map(|at| {
            json!({
                "level": at.level[0] + 1, "levels": at.level[1], "step": at.step[0], "steps": at.step[1],
                "psnr": at.psnr, "loss": at.loss, "roughness": at.roughness,
            })
        });
        let bar = state.bar.as_ref().map(|bar| {
            let BarAt { title, position, length, message, .. } = bar;
            json!({ "title": title, "position": position, "length": length, "message": message })
        });
        let points: usize = state.logs.iter().map(|log| log.columns[0].1.len()).sum();
        json!({
            "state": state.ended.as_deref().unwrap_or(running), "secs": self.begun.elapsed().as_secs_f64(),
            "pass": pass, "step": step, "bar": bar, "lines": state.lines, "points": points,
            "copy": state.copy.as_ref().map(|copy| json!({ "number": copy.number, "at": copy.at })),
        })
    }
}

impl State {
    fn note(&mut self, at: Moment) {
        match at {
            Moment::Pass { name, number, count } => {
                let (name, begun) = (name.to_owned(), Instant::now());
                self.pass = Some(PassAt { name, number, count, begun });
                self.step = None;
                self.log_every = LOG_EVERY;
            }
            Moment::Step { level, step, fit } => {
                let (loss, psnr) = (fit.sums.mean(), fit.sums.psnr());
                self.step = Some(StepAt { level, step, psnr, loss, roughness: fit.specular.roughness });
                let is_kept = step[0] == 1 || step[0] == step[1] || step[0].is_multiple_of(self.log_every);
                if let Some(pass) = self.pass.as_ref().filter(|_| is_kept) {
                    let color = fit.specular.albedo.to_array().map(f64::from);
                    let (secs, roughness) =
                        (pass.begun.elapsed().as_secs_f64(), f64::from(fit.specular.roughness));
                    let [r, g, b] = color;
                    let row = [f64::from(step[0]), secs, loss, psnr, r, g, b, roughness, fit.lobes as f64];
                    let name = pass.name.clone();
                    self.log(name, row);
                }
            }
        }
    }

    /// Adds a row to the log of a pass; a long log keeps every other one.
    fn log(&mut self, pass: String, row: [f64; 9]) {
        if self.logs.last().is_none_or(|log| log.pass != pass) {
            let columns = COLUMNS.map(|name| (name.to_owned(), Vec::new())).to_vec();
            self.logs.push(FitLog { pass, columns });
        }
        let Some(log) = self.logs.last_mut() else { return };
        for ((_, values), value) in log.columns.iter_mut().zip(row) {
            values.push(value);
        }
        if log.columns[0].1.len() > MOST_POINTS {
            self.log_every = self.log_every.saturating_mul(2);
            for (_, values) in &mut log.columns {
                *values = values.iter().copied().step_by(2).collect();
            }
        }
    }

    /// Where the run is, in words.
    fn words(&self) -> String {
        let pass = self.pass.as_ref().map_or("before the first pass", |pass| pass.name.as_str());
        self.step
            .map_or_else(|| pass.to_owned(), |at| format!("{pass}, step {} of {}", at.step[0], at.step[1]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_log_keeps_its_ends_and_few_points() {
        let mut state = State { log_every: LOG_EVERY, ..State::default() };
        for step in 0..20_000u32 {
            if step.is_multiple_of(state.log_every) {
                state.log("fit".into(), [f64::from(step); 9]);
            }
        }
        state.log("again".into(), [7.0; 9]);
        let steps = &state.logs[0].columns[0].1;
        assert!(
            steps.len() <= MOST_POINTS && steps[0] == 0.0 && steps.windows(2).all(|pair| pair[0] < pair[1])
        );
        assert_eq!(state.logs[1].columns[0].1, [7.0]);
    }

    #[test]
    fn what_a_run_says_is_bounded() {
        let shared = LiveRun::default();
        for i in 0..500 {
            shared.say(&format!("{i}{}", "x".repeat(5000)));
        }
        let json = shared.json(false);
        let lines = json["lines"].as_array().unwrap();
        assert_eq!(lines.len(), MOST_LINES);
        assert!(
            lines[199].as_str().unwrap().starts_with("499x")
                && lines[199].as_str().unwrap().len() == LONGEST_LINE
        );
        assert_eq!(
            (json["state"].as_str(), shared.json(true)["state"].as_str()),
            (Some("running"), Some("stopping"))
        );
    }

    #[test]
    fn only_the_bar_that_is_shown_changes() {
        let shared = LiveRun::default();
        shared.show_bar(BarAt { id: 1, length: 5, ..BarAt::default() });
        shared.show_bar(BarAt { id: 2, length: 9, ..BarAt::default() });
        shared.on_bar(1, |bar| bar.position = 4);
        shared.hide_bar(1);
        shared.on_bar(2, |bar| bar.position = 3);
        assert_eq!(shared.json(false)["bar"]["position"], 3);
        shared.hide_bar(2);
        assert!(shared.json(false)["bar"].is_null());
    }
}
