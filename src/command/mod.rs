//! What can be typed after `lobelia`, one file a command. No part of the library.
//!
//! | file | holds |
//! | --- | --- |
//! | [`args`], [`run_args`], [`prepare_args`], [`report_args`], [`view_args`] | arguments and their help |
//! | [`run`], [`check`], [`prepare`], [`new`], [`eval`], [`view`], [`report`], [`list`], [`env`], [`bench`], [`shade_cases`] | the commands |
//! | [`live`] | the page of a run that is at work |
//! | `ranks` | a run as one of several processes, with the feature `mpi` |
//! | [`terminal`] | bars, notes and results |
//! | [`error_message`] | how an error is drawn |
//! | [`scene_files`], [`threads`], [`output_checks`], [`signals`] | what several commands do before they start |

mod args;
mod bench;
mod check;
mod env;
mod error_message;
mod eval;
mod json_log;
mod list;
mod live;
mod new;
mod output_checks;
mod prepare;
mod prepare_args;
#[cfg(feature = "mpi")]
mod ranks;
mod report;
mod report_args;
mod run;
mod run_args;
mod scene_files;
mod shade_cases;
mod signals;
mod terminal;
mod terminal_picture;
mod threads;
mod view;
mod view_args;

use args::{Cli, Command};
use clap::Parser;
use lobelia::Result;
use std::io::Write as _;
use std::process::ExitCode;

/// Arguments in, one report of an error out, and the exit code.
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        // Help and version go to stdout and are no error. A closed pipe is not worth a word.
        Err(error) => {
            let _ = error.print();
            return if error.use_stderr() { ExitCode::from(2) } else { ExitCode::SUCCESS };
        }
    };
    match dispatch(&cli.command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = std::io::stderr().write_all(error_message::report(&error).as_bytes());
            ExitCode::from(error_message::exit_code(&error))
        }
    }
}

fn dispatch(command: &Command) -> Result<()> {
    match command {
        #[cfg(feature = "mpi")]
        Command::Run(args) => ranks::run(args),
        #[cfg(not(feature = "mpi"))]
        Command::Run(args) => run::run(args),
        Command::Check(args) => check::run(args),
        Command::Prepare(args) => prepare::run(args),
        Command::New(args) => new::run(args),
        Command::List(args) => list::run(args),
        Command::Eval(args) => eval::run(args),
        Command::View(args) => view::run(args),
        Command::Report(args) => report::run(args),
        Command::ShadeCases(args) => shade_cases::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Env(args) => env::run(&args.command),
    }
}
