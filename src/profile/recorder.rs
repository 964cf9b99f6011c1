//! The subscriber: sums up spans as they end.
//!
//! A part is known by its name, its kind and the part around it. Each thread has a stack of what is open on it; the lowest span of another
//! thread than the first is inside what the first one is at.

use super::chrome_trace::{Event, Events};
use super::clock::{Clock, ClockReading};
use super::part::{Part, PartKind, Profile};
use indexmap::IndexSet;
use std::fmt::{self, Write as _};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::{self, ThreadId};
use std::time::Duration;
use tracing::field::{Field, Visit};
use tracing::level_filters::LevelFilter;
use tracing::span::{Attributes, Id, Record};
use tracing::{Metadata, Subscriber};

/// The name of a schedule's conditions: all of them are one part.
const CONDITIONS: &str = "run conditions";
/// The index of the whole.
const WHOLE: usize = 0;
const BYTES_PER_MIB: f64 = (1 << 20) as f64;

/// A part in the making.
#[derive(Clone)]
struct Sum {
    /// Index of its name.
    name: usize,
    kind: PartKind,
    inside: Vec<usize>,
    runs: u64,
    time: ClockReading,
}

impl Sum {
    fn new(name: usize, kind: PartKind) -> Self {
        Self { name, kind, inside: Vec::new(), runs: 0, time: ClockReading::default() }
    }
}

/// A span that has been made.
#[derive(Clone, Copy)]
struct Made {
    name: usize,
    kind: PartKind,
    /// How many handles of it there are.
    handles: usize,
}

/// A span that is entered.
struct Open {
    span: u64,
    /// `None`: it is inside run conditions, which are systems as well, and is not measured.
    part: Option<usize>,
    begin: ClockReading,
}

struct State {
    names: IndexSet<String>,
    sums: Vec<Sum>,
    /// By the number of the span less one.
    made: Vec<Option<Made>>,
    free: Vec<usize>,
    open: Vec<(ThreadId, Vec<Open>)>,
    events: Option<Vec<Event>>,
    /// Events that are more than are kept.
    left_out: u64,
}

/// A `tracing` subscriber that measures.
pub(super) struct Recorder {
    clock: Clock,
    state: Mutex<State>,
}

impl Recorder {
    pub fn new(keeps_events: bool) -> Self {
        let state = State {
            names: IndexSet::from(["run".to_owned()]),
            sums: vec![Sum::new(0, PartKind::Whole)],
            made: Vec::new(),
            free: Vec::new(),
            open: vec![(thread::current().id(), Vec::new())],
            events: keeps_events.then(Vec::new),
            left_out: 0,
        };
        Self { clock: Clock::new(), state: Mutex::new(state) }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        // A panic in a span leaves the sums as they are.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn keeps_events(&self) -> bool {
        self.state().events.is_some()
    }

    /// The sums so far; what is open counts until now.
    pub fn profile(&self) -> Profile {
        let (now, state) = (self.clock.now(), self.state());
        let mut sums = state.sums.clone();
        (sums[WHOLE].runs, sums[WHOLE].time) = (1, now);
        for (part, open) in state.all_open() {
            sums[part].runs += 1;
            sums[part].time = sums[part].time.plus(now.since(open.begin));
        }
        let tree = Tree { names: &state.names, sums: &sums, whole: now, clock: &self.clock };
        Profile { threads: rayon::current_num_threads(), whole: tree.part(WHOLE) }
    }

    /// The events so far, with what is open as if it ended now.
    pub fn events(&self) -> Events {
        let (now, state) = (self.clock.now(), self.state());
        let whole = Event { part: WHOLE, thread: 0, begin: Duration::ZERO, took: now };
        let open = state.open.iter().enumerate().flat_map(|(thread, (_, stack))| {
            stack.iter().filter_map(move |open| {
                Some(Event { part: open.part?, thread, begin: open.begin.wall, took: now.since(open.begin) })
            })
        });
        let events = state
            .events
            .as_ref()
            .map(|kept| std::iter::once(whole).chain(open).chain(kept.iter().copied()).collect());
        let parts = state.sums.iter().map(|sum| (state.names[sum.name].clone(), sum.kind)).collect();
        let has_allocations = self.clock.has_allocations();
        Events { parts, events: events.unwrap_or_default(), has_allocations, left_out: state.left_out }
    }
}

impl Subscriber for Recorder {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        kind_of(metadata).is_some()
    }

    fn max_level_hint(&self) -> Option<LevelFilter> {
        Some(LevelFilter::INFO)
    }

    fn new_span(&self, span: &Attributes<'_>) -> Id {
        let kind = kind_of(span.metadata()).unwrap_or(PartKind::Stage);
        let mut name = Name::default();
        if kind != PartKind::Conditions {
            span.record(&mut name);
        }
        let name = match kind {
            PartKind::Conditions => CONDITIONS.to_owned(),
            PartKind::System => short(&name.0),
            PartKind::Commands => format!("commands of {}", short(&name.0)),
            _ => name.0,
        };
        Id::from_u64(self.state().make(name, kind))
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn event(&self, _: &tracing::Event<'_>) {}

    fn enter(&self, span: &Id) {
        self.state().enter(span.into_u64(), &self.clock);
    }

    fn exit(&self, span: &Id) {
        let now = self.clock.now();
        self.state().exit(span.into_u64(), now);
    }

    fn clone_span(&self, span: &Id) -> Id {
        self.state().handles(span.into_u64(), |handles| handles + 1);
        span.clone()
    }

    fn try_close(&self, span: Id) -> bool {
        self.state().handles(span.into_u64(), |handles| handles - 1) == 0
    }
}

impl State {
    /// Makes a span; returns its number, from 1.
    fn make(&mut self, name: String, kind: PartKind) -> u64 {
        let name = match self.names.get_index_of(&name) {
            Some(known) => known,
            None => self.names.insert_full(name).0,
        };
        let made = Some(Made { name, kind, handles: 1 });
        let at = match self.free.pop() {
            Some(at) => {
                self.made[at] = made;
                at
            }
            None => {
                self.made.push(made);
                self.made.len() - 1
            }
        };
        at as u64 + 1
    }

    /// Changes the number of handles of a span, which is gone with the last.
    fn handles(&mut self, span: u64, change: impl Fn(usize) -> usize) -> usize {
        let at = span as usize - 1;
        let Some(made) = &mut self.made[at] else { return 0 };
        made.handles = change(made.handles);
        let left = made.handles;
        if left == 0 {
            self.made[at] = None;
            self.free.push(at);
        }
        left
    }

    fn enter(&mut self, span: u64, clock: &Clock) {
        let Some(Made { name, kind, .. }) = self.made[span as usize - 1] else { return };
        let thread = self.thread();
        let around = self.open[thread].1.last().or(self.open[0].1.last()).map(|open| open.part);
        let measured = match around {
            None => Some(WHOLE),
            Some(part) => part.filter(|part| self.sums[*part].kind != PartKind::Conditions),
        };
        let part = measured.map(|around| self.part_in(around, name, kind));
        let begin = if part.is_some() { clock.now() } else { ClockReading::default() };
        self.open[thread].1.push(Open { span, part, begin });
    }

    fn exit(&mut self, span: u64, now: ClockReading) {
        let thread = self.thread();
        let stack = &mut self.open[thread].1;
        let Some(at) = stack.iter().rposition(|open| open.span == span) else { return };
        // Guards end in the reverse order of their begin.
        let Open { part, begin, .. } = stack.remove(at);
        let Some(part) = part else { return };
        let took = now.since(begin);
        self.sums[part].runs += 1;
        self.sums[part].time = self.sums[part].time.plus(took);
        if let Some(events) = &mut self.events {
            if events.len() < Events::MOST {
                events.push(Event { part, thread, begin: begin.wall, took });
            } else {
                self.left_out += 1;
            }
        }
    }

    /// The number of this thread.
    fn thread(&mut self) -> usize {
        let id = thread::current().id();
        self.open.iter().position(|(known, _)| *known == id).unwrap_or_else(|| {
            self.open.push((id, Vec::new()));
            self.open.len() - 1
        })
    }

    /// The part of this name and kind inside another.
    fn part_in(&mut self, around: usize, name: usize, kind: PartKind) -> usize {
        let is_it = |part: &&usize| (self.sums[**part].name, self.sums[**part].kind) == (name, kind);
        self.sums[around].inside.iter().find(is_it).copied().unwrap_or_else(|| {
            let new = self.sums.len();
            self.sums.push(Sum::new(name, kind));
            self.sums[around].inside.push(new);
            new
        })
    }

    fn all_open(&self) -> impl Iterator<Item = (usize, &Open)> {
        self.open.iter().flat_map(|(_, stack)| stack).filter_map(|open| Some((open.part?, open)))
    }
}

/// The sums as a tree.
struct Tree<'a> {
    names: &'a IndexSet<String>,
    sums: &'a [Sum],
    whole: ClockReading,
    /// Says what of its readings is known.
    clock: &'a Clock,
}

impl Tree<'_> {
    fn part(&self, index: usize) -> Part {
        let sum = &self.sums[index];
        let (wall, cpu) = (sum.time.wall.as_secs_f64(), sum.time.cpu.as_secs_f64());
        let of = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
        let measured = |value: f64| self.clock.has_cpu().then_some(value);
        let allocated = self.clock.has_allocations().then_some(sum.time.allocated);
        Part {
            name: self.names[sum.name].clone(),
            kind: sum.kind,
            runs: sum.runs,
            wall_secs: wall,
            wall_share: of(wall, self.whole.wall.as_secs_f64()),
            cpu_secs: measured(cpu),
            cpu_share: measured(of(cpu, self.whole.cpu.as_secs_f64())),
            threads_busy: measured(of(cpu, wall)),
            allocations: allocated.map(|allocated| allocated.count),
            allocated_mib: allocated.map(|allocated| allocated.bytes as f64 / BYTES_PER_MIB),
            parts: sum.inside.iter().map(|inside| self.part(*inside)).collect(),
        }
    }
}

/// What a span is; `None` if it is not measured.
fn kind_of(metadata: &Metadata<'_>) -> Option<PartKind> {
    if !metadata.is_span() {
        return None;
    }
    match (metadata.target().split("::").next(), metadata.name()) {
        (Some("lobelia"), "pass") => Some(PartKind::Pass),
        (Some("lobelia"), "stage") => Some(PartKind::Stage),
        (Some("bevy_ecs"), "schedule") => Some(PartKind::Schedule),
        (Some("bevy_ecs"), "check_conditions") => Some(PartKind::Conditions),
        (Some("bevy_ecs"), "system") => Some(PartKind::System),
        (Some("bevy_ecs"), "system_commands") => Some(PartKind::Commands),
        _ => None,
    }
}

/// The field `name` of a span.
#[derive(Default)]
struct Name(String);

impl Visit for Name {
    fn record_str(&mut self, field: &Field, value: &str) {
        if field.name() == "name" {
            self.0 = value.to_owned();
        }
    }

    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        if field.name() == "name" {
            self.0.clear();
            // Writing to a String cannot fail.
            let _ = write!(self.0, "{value:?}");
        }
    }
}

/// A system's name without the modules of its paths: `gather_points<Shown>`; a closure has that of its function.
pub(super) fn short(name: &str) -> String {
    let is_path = |c: char| c.is_alphanumeric() || "_:{}".contains(c);
    let mut found = String::new();
    let mut rest = name;
    while let Some(first) = rest.chars().next() {
        let length = rest.find(|c| is_path(c) != is_path(first)).unwrap_or(rest.len());
        let (word, after) = rest.split_at(length);
        let segments = word.split("::").filter(|segment| !segment.is_empty() && !segment.starts_with('{'));
        found.push_str(if is_path(first) { segments.last().unwrap_or(word) } else { word });
        rest = after;
    }
    found
}
