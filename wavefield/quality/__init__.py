"""What is wrong with cameras and records: delay, motion, blur, outlier cameras, consistency of pairs."""
