//! What the tests of the shell share: a router, configurations, options, and hooks that do nothing.

#![allow(dead_code, unused_macros, unused_imports, reason = "each test file uses another part")]

use muster_model::id::{FleetId, InstanceId};
use muster_runtime::bus::{Bus, ConnectTimeout};
use muster_runtime::config::{Mode, ProcessArgs, ProcessConfig};
use muster_runtime::kept::KeptStore;
use muster_runtime::observe::{Observatory, Observer};
use muster_runtime::records::{RecordOptions, RecordPlace};
use muster_runtime::shell::ServiceOptions;
use muster_runtime::store::Store;
use muster_service::Core;
use muster_service::records::{MemoryRecords, Records};

/// The items of a core that fetches nothing, publishes nothing by itself, and answers gets with nothing.
macro_rules! passive_core {
    () => {
        type Fetch = std::convert::Infallible;

        fn initial() -> Vec<Pattern> {
            Vec::new()
        }

        fn is_output(_: &Message) -> bool {
            false
        }

        fn on_follow(&mut self, _: &mut Context<'_, Self>, _: Vec<Message>) {}

        fn on_stand_down(&mut self, _: &mut Context<'_, Self>) {}

        fn on_new_term(&mut self, _: &mut Context<'_, Self>, _: Vec<Message>) {}

        fn on_get(&mut self, context: &mut Context<'_, Self>, get: Get) {
            context.reply(get, Vec::new());
        }

        fn state(&self, _: &View<'_, Self>) -> String {
            "probing".to_owned()
        }
    };
}
pub(crate) use passive_core;

pub(crate) fn config(args: ProcessArgs) -> ProcessConfig {
    let mode = args.mode.unwrap_or(Mode::Client);
    ProcessConfig::resolve(&args, mode, &|_| None).unwrap()
}

/// A router, and the endpoint that it listens at.
pub(crate) async fn router() -> (Bus, String) {
    let listen = Some(vec!["tcp/127.0.0.1:0".to_owned()]);
    let args = ProcessArgs { mode: Some(Mode::Router), listen, ..ProcessArgs::default() };
    let router = Bus::open(&config(args), ConnectTimeout::Never).await.unwrap();
    let endpoint = router.locators().await[0].clone();
    (router, endpoint)
}

/// The flags of a client of a router.
pub(crate) fn connected(endpoint: &str) -> ProcessArgs {
    ProcessArgs { connect: Some(vec![endpoint.to_owned()]), ..ProcessArgs::default() }
}

/// An observer whose service is not shown.
pub(crate) fn observer<C: Core>() -> Observer {
    let observatory = Observatory::open(&config(ProcessArgs::default()), &[]).unwrap();
    observatory.observer(C::SERVICE)
}

/// Options of a service that keeps nothing.
pub(crate) fn options<C: Core>(settings: C::Settings) -> ServiceOptions<C::Settings> {
    let fleet = FleetId::new("default").unwrap();
    let instance = InstanceId::of_process("test", 1, 1);
    let place = RecordPlace { folder: None, fleet: fleet.clone(), instance: instance.clone() };
    let open = |_: &RecordPlace| -> Result<Box<dyn Records>, String> {
        Ok(Box::<MemoryRecords>::default())
    };
    ServiceOptions {
        instance,
        settings,
        records: Some(RecordOptions { place, open }),
        store: Store::new(None, &fleet, C::SERVICE),
        kept: KeptStore::new(None, &fleet, C::SERVICE, C::WITHOUT_KEPT),
        record: None,
        pool: None,
        observer: observer::<C>(),
    }
}
