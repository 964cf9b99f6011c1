//! Arguments of `lobelia run`, and those that say which scene.

use super::threads::ThreadArgs;
use clap::{Args, ValueEnum};
use lobelia::pass::Profiling;
use std::path::PathBuf;
use std::time::Duration;

/// The help of the command.
pub const RUN_LONG: &str = "\
Runs the passes of a scene file in their order.

A scene file says what is known about an object (its surface, the photographs, the light, the material), what is
not, and what to do: Fit what is unknown, Render views, Edit the material, Relight it, Evaluate against the
truth, Save it as a scene of its own, Export it as .glb. Every pass has a name and writes into OUT/<name>/.

Inputs are never replaced, whatever OUT and passes are called. OUT/run.json says how far the run is and lists its
files; --force replaces those of an earlier run and nothing else. Only one run at a time writes into OUT.

Ctrl-C, SIGTERM and SIGHUP stop a run: what was found until then is scored, saved and exported. A run that was
stopped, killed, or failed goes on where it was with the same command and --resume. --live shows a run that is at
work in a browser.";

const SET_LONG: &str = "\
Replaces a value of the scene file, or adds it where it is left out. May be given many times.

PATH joins field names by dots. An item of a list is named by its number, by its `name`, or by its kind:
  --set seed=7
  --set passes.fit.rates.light=0.01
  --set passes.novel.render.shading='PathTraced(spp: 64)'
  --set material.specular.roughness='Fixed(0.25)'
  --set light.path=other.exr";

/// Which scene, and what the command line adds to it.
#[derive(Args, Debug)]
pub struct SceneArgs {
    /// The scene file
    #[arg(value_name = "SCENE.ron")]
    pub scene: PathBuf,
    /// The folder that $DATA stands for in the scene file
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Read also what the scene file names outside its own folder and --data
    #[arg(long)]
    pub allow_outside: bool,
    /// Seed of every random choice, instead of the scene's own
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    pub seed: Option<u64>,
    /// Replace a value of the scene file, e.g. --set passes.fit.steps=4
    #[arg(long = "set", value_name = "PATH=VALUE", value_parser = path_and_value, long_help = SET_LONG)]
    pub sets: Vec<(String, String)>,
}

/// `lobelia run`.
#[derive(Args, Debug)]
pub struct RunArgs {
    /// Which scene.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// The output folder [default: out/<name of the scene file>]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// SCENE.ron is a folder of scene files, a table objects.csv or the scene file of a film; run this unit of it (`lobelia list` names
    /// them) in OUT/UNIT: go on with one that was killed, and leave one that has finished [default of --out: out/<name of the folder or file>]
    #[arg(long, value_name = "UNIT", conflicts_with = "live")]
    pub only: Option<String>,
    /// Replace the results of an earlier run in the output folder, and nothing else
    #[arg(long)]
    pub force: bool,
    /// Go on with the run in the output folder from its last checkpoint, if there is one that has not finished; the
    /// result has the same bits as without a break
    #[arg(long, conflicts_with = "force")]
    pub resume: bool,
    /// Time between two checkpoints of a pass that takes long, at most a fiftieth of it: 30s, 5min, off
    #[arg(long, value_name = "TIME", default_value = "30s", value_parser = checkpoint_time)]
    pub checkpoint: CheckpointTime,
    /// How many threads.
    #[command(flatten)]
    pub threads: ThreadArgs,
    /// Memory that the run keeps to, by smaller pools of pixels, or is refused: 8GiB, 500MiB
    /// [default: three quarters of what a process may have]
    #[arg(long, value_name = "SIZE", value_parser = lobelia::pass::memory::parse_bytes)]
    pub memory: Option<u64>,
    /// What shades in closed form, where the object has one base material: `cpu`, `gpu`, or a part of a graphics adapter's name; the GPU's results
    /// have other bits, and need a program built with the feature `gpu`
    #[arg(long, value_name = "NAME", default_value = "cpu")]
    pub device: String,
    /// While a shape is found, write its normals, depth and mesh every N steps
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub debug_every: Option<u32>,
    /// Measure where the time goes: a table at the end and in metrics.json; with `trace` also OUT/trace.json, which
    /// Perfetto opens
    #[arg(long, value_name = "FORM", num_args = 0..=1, require_equals = true, default_missing_value = "table")]
    profile: Option<ProfileForm>,
    /// Serve a page about the run on 127.0.0.1 while it works, at this port or one that is free: curves, the object as it is,
    /// the worst views, a button that stops the run; its address goes to standard error
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "0", value_parser = port)]
    pub live: Option<u16>,
    /// What a run says: text for a person, or a line of JSON for each event, on standard output
    #[arg(long, value_name = "FORM", default_value = "text", conflicts_with = "quiet")]
    pub log: LogForm,
    /// Nothing but errors on the terminal: no progress bars, no notes, no results
    #[arg(short, long)]
    pub quiet: bool,
}

/// What a run says.
#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
pub enum LogForm {
    /// Bars, notes and results
    Text,
    /// Events, for programs
    Json,
}

/// What `--profile` leaves.
#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum ProfileForm {
    /// A table, and a section of metrics.json
    Table,
    /// Also a trace
    Trace,
}

impl RunArgs {
    /// Whether the run measures where its time goes.
    pub fn profile(&self) -> Profiling {
        match self.profile {
            None => Profiling::Off,
            Some(ProfileForm::Table) => Profiling::Table,
            Some(ProfileForm::Trace) => Profiling::Trace,
        }
    }
}

/// Time between two checkpoints; `None`: there are none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CheckpointTime(pub Option<Duration>);

/// "30s", "5min", "1h" or "off".
fn checkpoint_time(text: &str) -> Result<CheckpointTime, String> {
    let text = text.trim();
    if text == "off" {
        return Ok(CheckpointTime(None));
    }
    let digits = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
    let unit = match text[digits..].trim() {
        "" | "s" => 1.0,
        "min" | "m" => 60.0,
        "h" => 3600.0,
        _ => f64::NAN,
    };
    let seconds = text[..digits].trim().parse::<f64>().unwrap_or(f64::NAN) * unit;
    if (0.0..=1e6).contains(&seconds) {
        Ok(CheckpointTime(Some(Duration::from_secs_f64(seconds))))
    } else {
        Err("give a time such as 30s or 5min, or `off`".to_owned())
    }
}

fn port(text: &str) -> Result<u16, String> {
    text.parse()
        .map_err(|_| "give a port from 1 to 65535, or none; the scene file comes before `--live`".to_owned())
}

fn path_and_value(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((path, value)) if !path.trim().is_empty() && !value.trim().is_empty() => {
            Ok((path.trim().to_owned(), value.trim().to_owned()))
        }
        _ => Err("expected PATH=VALUE, e.g. passes.fit.steps=4".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_between_checkpoints_have_a_unit_or_are_off() {
        let time = |text: &str| checkpoint_time(text).unwrap().0;
        assert_eq!(time("off"), None);
        assert_eq!((time("30s"), time("30")), (Some(Duration::from_secs(30)), Some(Duration::from_secs(30))));
        assert_eq!(
            (time("5 min"), time("1.5h")),
            (Some(Duration::from_secs(300)), Some(Duration::from_secs(5400)))
        );
        for wrong in ["", "on", "-1s", "5 parsecs", "nan", "1e9h", "s"] {
            assert!(checkpoint_time(wrong).unwrap_err().contains("30s"), "{wrong}");
        }
    }

    #[test]
    fn a_live_page_has_a_port_or_any() {
        assert_eq!((port("8080"), port("0")), (Ok(8080), Ok(0)));
        for wrong in ["scene.ron", "65536", "-1", ""] {
            assert!(port(wrong).unwrap_err().contains("65535"), "{wrong}");
        }
    }

    #[test]
    fn set_takes_the_first_equals_sign() {
        assert_eq!(path_and_value("a.b = x=1"), Ok(("a.b".into(), "x=1".into())));
        assert!(
            path_and_value("a.b").is_err() && path_and_value("=1").is_err() && path_and_value("a=").is_err()
        );
    }
}
