"""Training: the sample that is drawn, trees and forests, importance of features, other kinds of classifier."""
