//! The page: what a client says on a connection, with a token (the first byte is odd) and without.
//! Parser: crates/daemon/src/sink/http/mod.rs:read_token,problem,in_time,admit,check_origin,check_site,bearer,cookie,same,by_query,let_in,asset,metrics,overview,status,no_axis,axis,trend,cycles,healthy,acknowledge,new_baseline,repairs,order,healthz,history,events crates/daemon/src/sink/http/login.rs crates/daemon/src/sink/http/connections.rs:converse crates/daemon/src/hub/order.rs:from_json,said
#![no_main]
use std::cell::RefCell;
use std::sync::Arc;

use seepd::clock::Clock;
use seepd::config::HttpConfig;
use seepd::hub::{AxisStatus, Hub, Order};
use seepd::sink::http::{Heard, Http};
use tokio::runtime::Runtime;
use tokio::sync::{mpsc, watch};

struct Site {
    runtime: Runtime,
    orders: mpsc::Receiver<Order>,
    sites: [Heard; 2],
    _stop: watch::Sender<bool>,
}

thread_local! {
    static SITE: RefCell<Site> = RefCell::new(site());
}

fn site() -> Site {
    // Its clock goes on where nothing else does: no beat of an event stream and no patience with a client is waited for.
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .start_paused(true)
        .build()
        .expect("a runtime");
    let hub = Hub::new("fuzzed".into());
    let (sender, orders) = mpsc::channel(2);
    hub.add_axis(AxisStatus::new("press", 7e6), sender);
    // One that has ended.
    hub.add_axis(AxisStatus::new("ended", 7e6), mpsc::channel(1).0);
    let file = std::env::temp_dir().join(format!("fuzzed-token-{}", std::process::id()));
    std::fs::write(&file, "0123456789abcdef").expect("a file");
    let (stop, stopped) = watch::channel(false);
    let sites = [None, Some(file.clone())].map(|token_file| {
        let config = HttpConfig { token_file, ..HttpConfig::default() };
        Heard::by(Http::new(&config, Arc::clone(&hub), Clock::start(), stopped.clone()).ok().expect("a site"))
    });
    std::fs::remove_file(&file).expect("its own file");
    Site { runtime, orders, sites, _stop: stop }
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Some((which, said)) = data.split_first() else { return };
    SITE.with_borrow_mut(|site| {
        site.runtime.block_on(site.sites[usize::from(which % 2)].hear(said));
        while site.orders.try_recv().is_ok() {}
    });
});
