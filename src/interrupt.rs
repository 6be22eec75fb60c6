//! Turns signals into the stop wish, on a real-time runtime of its own: the campaign's clock may be virtual.

use crate::campaign::{StopFlag, Wish};
use std::io::Write;

/// Listens for Ctrl-C, SIGTERM and SIGHUP until the program ends. Ctrl-C once pauses after the cycle, twice stops
/// now; SIGTERM and SIGHUP stop now.
///
/// # Errors
///
/// The system's words when no thread or handler can be had.
pub fn listen(stop: StopFlag) -> std::io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    // Opened before this returns: without handlers a signal would end the program with a hot plate.
    let mut streams = {
        let _inside = runtime.enter();
        Streams::open()?
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(move || {
        runtime.block_on(async move {
            while let Some(interrupt) = streams.next().await {
                match interrupt {
                    Signal::Interrupt => stop.escalate(),
                    Signal::End => stop.stop(),
                }
                let text = match stop.wish() {
                    Wish::Pause => {
                        "pausing after this cycle; Ctrl-C again stops now. The rig will be made safe."
                    }
                    Wish::Stop => "stopping now; the rig is being brought to its safe state.",
                    Wish::GoOn => continue,
                };
                // A terminal that has gone must not keep the next signal from being heard.
                let _ = writeln!(std::io::stderr(), "\nditd: {text}");
            }
        });
    })?;
    Ok(())
}

enum Signal {
    Interrupt,
    #[cfg_attr(not(unix), expect(dead_code, reason = "only Unix has these signals"))]
    End,
}

#[cfg(unix)]
struct Streams {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
    hangup: tokio::signal::unix::Signal,
}

#[cfg(unix)]
impl Streams {
    fn open() -> std::io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
            hangup: signal(SignalKind::hangup())?,
        })
    }

    async fn next(&mut self) -> Option<Signal> {
        tokio::select! {
            got = self.interrupt.recv() => got.map(|()| Signal::Interrupt),
            got = self.terminate.recv() => got.map(|()| Signal::End),
            got = self.hangup.recv() => got.map(|()| Signal::End),
        }
    }
}

#[cfg(not(unix))]
struct Streams;

#[cfg(not(unix))]
impl Streams {
    fn open() -> std::io::Result<Self> {
        Ok(Self)
    }

    async fn next(&mut self) -> Option<Signal> {
        tokio::signal::ctrl_c().await.ok().map(|()| Signal::Interrupt)
    }
}
