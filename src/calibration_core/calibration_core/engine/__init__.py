"""Many independent pieces of work on a Dask cluster: a local one, or any scheduler that has an address.

Queue, retries, load balancing and limits of memory are Dask's.  What a worker was doing when it ended is done again by
another; what has ended `ALLOWED_FAILURES` + 1 workers is given up, and is reported as such.  A local worker takes one
piece at a time, so that the piece in it is the one that ended it.

`arguments` (where the work is to be done), `cluster` (a client of it), `pieces` (the work).
"""
