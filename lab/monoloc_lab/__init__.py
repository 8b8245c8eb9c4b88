"""What a researcher runs and a drone never carries: experiments, baselines, rendered rooms, benchmarks."""
