"""Research tools for monoloc: experiments, baselines, rendered rooms, benchmarks. A drone does not need them."""
