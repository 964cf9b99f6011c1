//! The `lobelia` command: its subcommands, each with its arguments.
//!
//! | file | holds |
//! | --- | --- |
//! | [`run`], [`check`], [`prepare`], [`view`], [`report`], [`env`], [`bench`] | the commands; `new` is in [`prepare`], `eval` in [`report`] |
//! | [`profile`] | where the time of a run goes |
//! | [`terminal`] | bars, notes and results, for a person and for programs |
//! | [`error_message`] | how an error is drawn |
//! | [`start`] | arguments that commands share, and what they do before they work |

mod bench;
mod check;
mod env;
mod error_message;
mod prepare;
mod profile;
mod report;
mod run;
mod start;
mod terminal;
mod view;

use clap::{Parser, Subcommand, error::ContextKind, error::ContextValue};
use std::{io::Write as _, process::ExitCode};

const EXAMPLES: &str = include_str!("help/lobelia.txt").trim_ascii_end();

/// Recovers surface, material and light of a photographed object as spherical Gaussians; then edits
/// and relights it.
#[derive(Debug, Parser)]
#[command(name = "lobelia", version = env!("LOBELIA_VERSION"), after_long_help = EXAMPLES, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

/// The commands; the comment of each one's arguments is its help.
#[derive(Debug, Subcommand)]
enum Command {
    #[command(after_long_help = EXAMPLES)]
    Run(run::RunArgs),
    Check(check::CheckArgs),
    Prepare(prepare::PrepareArgs),
    New(prepare::NewArgs),
    View(view::ViewArgs),
    Report(report::ReportArgs),
    Eval(report::EvalArgs),
    Bench(bench::BenchArgs),
    /// Environment light: fit SG lobes to a map, draw lobes as a map, turn a light, say what is in
    /// it
    #[command(subcommand, after_long_help = env::EXAMPLES)]
    Env(env::EnvCommand),
}

/// Arguments in, one report of an error out, and the exit code.
fn main() -> ExitCode {
    lobelia::set_version(env!("LOBELIA_VERSION"));
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        // Help and version go to stdout and are no error. A closed pipe is not worth a word.
        Err(error) => {
            let _ = match gone_word(&error) {
                Some((word, instead)) => {
                    writeln!(std::io::stderr(), "error: lobelia no longer has `{word}`\n\nhelp: {instead}")
                }
                None => error.print(),
            };
            return if error.use_stderr() { ExitCode::from(2) } else { ExitCode::SUCCESS };
        }
    };
    let ended = match &cli.command {
        Command::Run(args) => run::run(args),
        Command::Check(args) => check::run(args),
        Command::Prepare(args) => prepare::run(args),
        Command::New(args) => prepare::new(args),
        Command::Eval(args) => report::eval(args),
        Command::View(args) => view::run(args),
        Command::Report(args) => report::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Env(command) => env::run(command),
    };
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = std::io::stderr().write_all(error_message::report(&error).as_bytes());
            ExitCode::from(error_message::exit_code(&error))
        }
    }
}

const ONE_OBJECT: &str =
    "Run `lobelia run SCENE --out OUT/NAME --resume` for each object; examples/jobs has scripts that do.";

/// Words that commands once had, and what to do instead.
const GONE: [(&str, &str); 9] = [
    ("list", ONE_OBJECT),
    ("--only", ONE_OBJECT),
    ("--jobs", "Give the folders of the runs: `lobelia report OUT/* --csv`."),
    ("--allow-outside", "Leave it out: a scene file reads whatever it names."),
    ("--frames", "A film is made by one run; give several films a pass each."),
    ("--processes", "One object is fitted by one process; --threads says with how many threads."),
    (
        "--checkpoint",
        "Leave it out: a run saves its state at the end of each pass and once a minute in a fit.",
    ),
    ("--backdrop", "Masks are made by a program: install rembg, or give --mask-command or --masks."),
    (
        "shade-cases",
        "The example does the same: `cargo run --release --example shade_cases -- cases.json shaded.json`.",
    ),
];

/// A word that a command once had, and what to do instead.
fn gone_word(error: &clap::Error) -> Option<(&'static str, &'static str)> {
    let given = error.get(ContextKind::InvalidArg).or_else(|| error.get(ContextKind::InvalidSubcommand));
    let Some(ContextValue::String(word)) = given else { return None };
    GONE.into_iter().find(|(gone, _)| word.split(['=', ' ']).next() == Some(gone))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_commands_are_well_formed() {
        use clap::CommandFactory;
        Cli::command().debug_assert();
    }
}
