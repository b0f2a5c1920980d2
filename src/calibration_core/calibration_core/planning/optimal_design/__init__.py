"""Which of many candidates to measure: criteria, exchange, and what any choice could reach."""
