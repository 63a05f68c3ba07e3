"""A recorded ledger as a table and a chart: what was asked beside what was delivered."""
