"""What the campaigns in benchmarks/ and the tests share: drawn cases, damaged files, faults, own plants, judges."""
