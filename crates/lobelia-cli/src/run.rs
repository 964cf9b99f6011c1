//! `lobelia run`: the passes of a scene file, in their order.

use super::start::{Choices, SceneArgs, ThreadArgs, choices, load_options, start_threads, stop_on_signals};
use super::{profile::Profiler, terminal::JsonLog, terminal::Terminal};
use clap::{ArgAction, Args};
use lobelia::error::stop::is_stopping;
use lobelia::scene::load;
use lobelia::shade::device::ShadingDevice;
use lobelia::{Result, pass, pass::RunOptions, pass::memory::usual_budget, progress::Progress};
use std::{path::Path, path::PathBuf, sync::Arc, time::Instant};

/// Runs the passes of a scene file in their order.
///
/// A scene file says what is known about an object (its surface, the photographs, the light, the
/// material), what is not, and what to do: Fit what is unknown, Render views, Edit the material,
/// Relight it, Evaluate against the truth, Save it as a scene of its own, Export it as .glb. Every
/// pass has a name and writes into OUT/<name>/.
///
/// Inputs are never replaced, whatever OUT and passes are called. OUT/run.json says how far the run
/// is and lists its files; --force replaces those of an earlier run and nothing else. Only one run
/// at a time writes into OUT.
///
/// Ctrl-C, SIGTERM and SIGHUP stop a run: what was found until then is scored, saved and exported.
/// A run that was stopped, killed, or failed goes on where it was with the same command and
/// --resume. --live shows a run that is at work in OUT/report.html.
#[derive(Args, Debug)]
#[command(about = "Run the passes of a scene file", verbatim_doc_comment)]
pub struct RunArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// The output folder [default: out/<name of the scene file>]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Replace the results of an earlier run in the output folder, and nothing else
    #[arg(long)]
    force: bool,
    /// Go on with the run in the output folder from its last checkpoint, if there is one that has
    /// not finished; the result has the same bits as without a break
    #[arg(long, conflicts_with = "force")]
    resume: bool,
    #[command(flatten)]
    threads: ThreadArgs,
    /// Memory that the run keeps to, by smaller pools of pixels, or is refused: 8GiB, 500MiB
    /// [default: three quarters of what a process may have]
    #[arg(long, value_name = "SIZE", value_parser = lobelia::pass::memory::parse_bytes)]
    memory: Option<u64>,
    /// Processor that shades in closed form, where the object has one base material: `cpu`, `gpu`,
    /// or a part of a graphics adapter's name; the GPU's results have other bits, and need a
    /// program built with the feature `gpu`
    #[arg(long, value_name = "NAME", default_value = "cpu")]
    device: String,
    /// While a shape is found, write its normals, depth and mesh every N steps
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    debug_every: Option<u32>,
    /// Measure where the time goes: a table on standard error at the end and in OUT/profile.txt;
    /// with `trace` also OUT/trace.json, which Perfetto opens
    #[arg(long, value_name = "FORM", num_args = 0..=1, require_equals = true, default_missing_value = "table",
        value_parser = choices(PROFILES))]
    profile: Option<bool>,
    /// Write OUT/report.html every few seconds while a fit or shape is found: curves and the worst
    /// views; the page loads itself again
    #[arg(long)]
    live: bool,
    /// Form of a run's messages: text for a person, or a line of JSON for each event, on standard
    /// output
    #[arg(long, value_name = "FORM", default_value = "text", conflicts_with = "quiet", action = ArgAction::Set,
        value_parser = choices(LOGS))]
    log: bool,
    /// Nothing but errors on the terminal: no progress bars, no notes, no results
    #[arg(short, long)]
    quiet: bool,
}

/// Forms of messages, and whether they are JSON.
const LOGS: Choices<bool> =
    &[("text", false, "Bars, notes and results"), ("json", true, "Events, for programs")];
/// Forms of a profile, and whether they have a trace.
const PROFILES: Choices<bool> = &[("table", false, "A table"), ("trace", true, "Also a trace")];

/// Runs the command.
pub fn run(args: &RunArgs) -> Result<()> {
    if !args.log {
        return carry_out(args, Arc::new(Terminal { quiet: args.quiet }));
    }
    let log = Arc::new(JsonLog { start: Instant::now() });
    let ended = carry_out(args, log.clone());
    log.end(&ended);
    ended
}

/// Runs the scene, and reports to `shown`.
fn carry_out(args: &RunArgs, shown: Arc<dyn Progress>) -> Result<()> {
    let name = args.scene.scene.file_stem().unwrap_or_default();
    let out = args.out.clone().unwrap_or_else(|| Path::new("out").join(name));
    let loaded = load(&args.scene.scene, &load_options(&args.scene))?;
    start_threads(args.threads)?;
    let options = RunOptions {
        out,
        force: args.force,
        debug_every: args.debug_every,
        memory: args.memory.or_else(usual_budget),
        arguments: std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()).collect(),
        resume: args.resume,
        device: (args.device != "cpu").then(|| ShadingDevice::open(&args.device)).transpose()?,
        live: args.live,
        ..RunOptions::default()
    };
    stop_on_signals()?;
    let profiler = args.profile.map(Profiler::start).transpose()?;
    let ended = pass::run(&loaded, &options, shown);
    match profiler {
        Some(profiler) if ended.is_ok() || is_stopping() => ended.and(profiler.finish(&options.out)),
        // A run that was refused writes nothing.
        _ => ended,
    }
}
