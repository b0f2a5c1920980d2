"""Several recordings of one robot, evaluated together: what belongs to the robot is shared, each set-up has its own."""
