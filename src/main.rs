//! The `lobelia` command.
fn main() {}
