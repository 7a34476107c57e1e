//! Three hosts in network namespaces, the faults of their links, and what users see of them.
//!
//! The hosts are the robots', the base with the services, and the router's, joined by a bridge in a
//! fourth namespace. [`lab`] makes them and breaks their links; [`fault`] names the faults and what is
//! promised under each; [`run_plan`] makes one happen to a running fleet; [`record`] reads what the
//! observers on two of the hosts have seen, and measures it. [`sites`] makes the hosts sites, and measures what crosses their
//! links.

pub mod fault;
pub mod lab;
pub mod record;
pub mod run_plan;
pub mod sites;
