//! `lobelia run --profile`: where the time goes, by the `tracing` spans of passes, stages,
//! schedules and systems.

use lobelia::{Error, Result};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use std::{collections::HashMap, fmt, fs::File, io, io::Seek as _, io::Write as _, path::Path};
use tracing::{field::Field, field::Visit, span::Attributes, span::Id, subscriber::set_global_default};
use tracing_chrome::{ChromeLayerBuilder, EventOrSpan, FlushGuard};
use tracing_subscriber::layer::{Context, Layered, SubscriberExt};
use tracing_subscriber::{Layer, registry::LookupSpan, registry::Registry};

/// The table, in the output folder.
const TABLE: &str = "profile.txt";
/// The trace, which Perfetto opens, in the output folder.
const TRACE: &str = "trace.json";

/// How often spans of a name have ended, and how long they took together.
type Sums = Arc<Mutex<HashMap<String, (u64, Duration)>>>;

/// Measures from its beginning on.
pub struct Profiler {
    sums: Sums,
    began: Instant,
    /// The trace so far, in a file without a name until the output folder is known to be writable.
    trace: Option<(File, FlushGuard)>,
}

impl Profiler {
    /// Listens to all spans of the process from now on.
    pub fn start(with_trace: bool) -> Result<Self> {
        let sums = Sums::default();
        let spans = Registry::default().with(SumLayer(sums.clone()));
        let (set, trace) = if with_trace {
            let file = tempfile::tempfile().and_then(|file| Ok((file.try_clone()?, file)));
            let (copy, file) = file.map_err(Error::io("create", std::env::temp_dir()))?;
            let builder = ChromeLayerBuilder::<Layered<SumLayer, Registry>>::new().include_locations(false);
            let (layer, guard) = builder.writer(copy).name_fn(Box::new(name_in_trace)).build();
            (set_global_default(spans.with(layer)), Some((file, guard)))
        } else {
            (set_global_default(spans), None)
        };
        set.map_err(|error| Error::run("--profile", error.to_string()))?;
        Ok(Self { sums, began: Instant::now(), trace })
    }

    /// Prints the table on standard error, and writes it and the trace into the output folder.
    pub fn finish(self, out: &Path) -> Result<()> {
        // A line per name, the longest time first; spans inside others count in both.
        let sums = self.sums.lock().unwrap_or_else(PoisonError::into_inner);
        let mut rows: Vec<_> = sums.iter().collect();
        rows.sort_by(|(a, (_, x)), (b, (_, y))| y.cmp(x).then(a.cmp(b)));
        let secs = self.began.elapsed().as_secs_f64();
        let mut table = format!("{:>9}  {:>9}  of {secs:.2} s\n", "wall s", "count");
        for (name, (count, time)) in rows {
            table += &format!("{:>9.3}  {count:>9}  {name}\n", time.as_secs_f64());
        }
        drop(sums);
        let _ = io::stderr().write_all(table.as_bytes());
        std::fs::write(out.join(TABLE), table).map_err(Error::io("write", out.join(TABLE)))?;
        let Some((mut file, guard)) = self.trace else { return Ok(()) };
        // Waits until all is written.
        drop(guard);
        let written = file.rewind().and_then(|()| io::copy(&mut file, &mut File::create(out.join(TRACE))?));
        written.map(drop).map_err(Error::io("write", out.join(TRACE)))
    }
}

/// Sums spans by name as they are left.
struct SumLayer(Sums);

/// A span's name, and when it was entered.
struct Entered(String, Option<Instant>);

impl<S: tracing::Subscriber + for<'a> LookupSpan<'a>> Layer<S> for SumLayer {
    fn on_new_span(&self, attributes: &Attributes<'_>, id: &Id, context: Context<'_, S>) {
        let mut name = Name(attributes.metadata().name().to_owned());
        attributes.record(&mut name);
        let name = match attributes.metadata().name() {
            "system_commands" => format!("commands of {}", short(&name.0)),
            "check_conditions" => "run conditions".to_owned(),
            _ => short(&name.0),
        };
        if let Some(span) = context.span(id) {
            span.extensions_mut().insert(Entered(name, None));
        }
    }

    fn on_enter(&self, id: &Id, context: Context<'_, S>) {
        let Some(span) = context.span(id) else { return };
        let mut extensions = span.extensions_mut();
        if let Some(entered) = extensions.get_mut::<Entered>() {
            entered.1 = Some(Instant::now());
        }
    }

    fn on_exit(&self, id: &Id, context: Context<'_, S>) {
        let Some(span) = context.span(id) else { return };
        let mut extensions = span.extensions_mut();
        let Some(Entered(name, at)) = extensions.get_mut::<Entered>() else { return };
        let Some(at) = at.take() else { return };
        let mut sums = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let sum = sums.entry(name.clone()).or_default();
        *sum = (sum.0 + 1, sum.1 + at.elapsed());
    }
}

/// The name of a span as in the table.
fn name_in_trace<S: tracing::Subscriber + for<'a> LookupSpan<'a> + Send + Sync>(
    of: &EventOrSpan<'_, '_, S>,
) -> String {
    match of {
        EventOrSpan::Event(event) => event.metadata().name().to_owned(),
        EventOrSpan::Span(span) => {
            let extensions = span.extensions();
            extensions.get::<Entered>().map_or_else(|| span.name().to_owned(), |entered| entered.0.clone())
        }
    }
}

/// The field `name` of a span, or else its own name.
struct Name(String);

impl Visit for Name {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        if field.name() == "name" {
            self.0 = format!("{value:?}").trim_matches('"').to_owned();
        }
    }
}

/// The name of a system without the modules of its paths: `gather_points<Shown>`; a closure has
/// that of its function.
fn short(name: &str) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_systems_are_short() {
        assert_eq!(short("lobelia::shade::gather_points<lobelia::fit::Shown>"), "gather_points<Shown>");
        assert_eq!(short("lobelia::light::provide_light::{{closure}}"), "provide_light");
        assert_eq!(short("pass fit"), "pass fit");
    }
}
