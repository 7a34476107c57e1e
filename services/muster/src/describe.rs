//! `muster completions` and `muster manual`: the program described to shells and to `man`.

use std::io::Write as _;

use clap_complete::Shell;

/// Arguments of `muster completions`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
muster completions bash > /usr/share/bash-completion/completions/muster\n  \
muster completions zsh > \"${fpath[1]}/_muster\"\n  \
muster completions fish > ~/.config/fish/completions/muster.fish")]
pub(crate) struct CompletionsArgs {
    /// The shell
    #[arg(value_name = "SHELL")]
    shell: Shell,
}

/// Arguments of `muster manual`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  muster manual | man -l -                                     read it\n  \
muster manual > /usr/local/share/man/man1/muster.1            install it\n  \
muster manual teams > /usr/local/share/man/man1/muster-teams.1"
)]
pub(crate) struct ManualArgs {
    /// The page of this command; the page of the whole program if none is named
    #[arg(value_name = "COMMAND")]
    command: Option<String>,
}

/// Prints completions.
///
/// # Errors
/// If the output cannot be written.
pub(crate) fn completions(
    args: &CompletionsArgs,
    mut command: clap::Command,
) -> anyhow::Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "muster", &mut script);
    Ok(std::io::stdout().lock().write_all(&script)?)
}

/// Prints a manual page as roff.
///
/// # Errors
/// If there is no such command, or the output cannot be written.
pub(crate) fn manual(args: &ManualArgs, mut command: clap::Command) -> anyhow::Result<()> {
    command.build();
    let page = match &args.command {
        None => command,
        Some(name) => {
            let Some(found) = command.find_subcommand(name) else {
                let known: Vec<_> =
                    command.get_subcommands().map(clap::Command::get_name).collect();
                let name = muster_wire::message::quoted(name);
                let problem =
                    format!("COMMAND: there is no {name:?}; there are {}", known.join(", "));
                return Err(muster_runtime::exit::ExitError::usage(problem).into());
            };
            // With the name that its page is installed and looked up under.
            found.clone().name(format!("muster-{name}"))
        }
    };
    let mut roff = Vec::new();
    clap_mangen::Man::new(page).render(&mut roff)?;
    Ok(std::io::stdout().lock().write_all(&roff)?)
}
