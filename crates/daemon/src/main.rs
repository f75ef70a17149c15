//! The `seepd` program: a call into its library.

use std::process::ExitCode;

fn main() -> ExitCode {
    seepd::main()
}
