//! The `lobelia` command.

mod command;

use lobelia::profile::CountingAllocator;
use std::process::ExitCode;

/// For the allocations of `run --profile`.
#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator::system();

fn main() -> ExitCode {
    command::main()
}
