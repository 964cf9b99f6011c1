//! Spans as a trace in the JSON format of Chrome's tracing, which Perfetto opens.

use super::clock::ClockReading;
use super::part::PartKind;
use serde_json::json;
use std::io::{self, Write};
use std::time::Duration;

/// A span that has ended.
#[derive(Clone, Copy, Debug)]
pub(super) struct Event {
    pub part: usize,
    pub thread: usize,
    /// On the wall clock.
    pub begin: Duration,
    pub took: ClockReading,
}

/// All events, with the names and kinds of their parts.
pub(super) struct Events {
    pub parts: Vec<(String, PartKind)>,
    pub events: Vec<Event>,
    /// Whether allocations are known.
    pub has_allocations: bool,
    /// How many there were beyond [`Self::MOST`].
    pub left_out: u64,
}

impl Events {
    /// Most events that are kept: some 80 MB of memory, 200 MB of JSON.
    pub const MOST: usize = 1_000_000;
}

/// Writes one event a line.
pub(super) fn write(events: &Events, writer: &mut impl Write) -> io::Result<()> {
    let about = json!({ "program": concat!("lobelia ", env!("CARGO_PKG_VERSION")), "events_left_out": events.left_out });
    write!(writer, "{{\"displayTimeUnit\":\"ms\",\"otherData\":{about},\"traceEvents\":[")?;
    let name = json!({ "name": "process_name", "ph": "M", "pid": 1, "args": { "name": "lobelia" } });
    write!(writer, "\n{name}")?;
    let micros = |time: Duration| time.as_nanos() as f64 / 1000.0;
    for Event { part, thread, begin, took } in &events.events {
        let (name, kind) = &events.parts[*part];
        let mut args = json!({ "cpu_us": micros(took.cpu) });
        if events.has_allocations {
            args["allocations"] = took.allocated.count.into();
            args["allocated_bytes"] = took.allocated.bytes.into();
        }
        let event = json!({
            "name": name, "cat": kind, "ph": "X", "pid": 1, "tid": thread + 1,
            "ts": micros(*begin), "dur": micros(took.wall), "args": args,
        });
        write!(writer, ",\n{event}")?;
    }
    writer.write_all(b"\n]}\n")
}
