"""Questions to a field: texts to things and Gaussians, decided once in the scene and drawn in views.

``LanguageField`` has a method for each question; its answers, catalogues, labels, edits and comparisons have writers
beside them. A question changes nothing.
"""

from scoup.query.answer import Answer, ExpressionAnswer
from scoup.query.answer_files import AnswerFiles
from scoup.query.ask import answers_of, things_of_question
from scoup.query.boxes import OrientedBox, PointSets
from scoup.query.catalog import related_objects
from scoup.query.catalog_writing import draw_things, save_catalog, thing_mask
from scoup.query.compare_files import save_comparison
from scoup.query.comparison import compare
from scoup.query.drawing import (
    drawing,
    heat_frames,
    placed_atoms,
)
from scoup.query.edits import SplatTable, edit_picture, edited
from scoup.query.expression import Expression, parse_expression
from scoup.query.field_view import FieldView
from scoup.query.frame import Frame
from scoup.query.label_writing import LabelFiles
from scoup.query.labels import GaussianLabels
from scoup.query.language_field import LanguageField, build
from scoup.query.named import Named, find_named
from scoup.query.phrases import texts_of
from scoup.query.place import Place
from scoup.query.presence import (
    Certainty,
    TextScore,
    presence_threshold,
    text_scores,
)
from scoup.query.question import (
    Question,
    Several,
    TextVectors,
    check_encoder,
    encode_texts,
    make_question,
    near_names,
    warn_of_another_model,
)
from scoup.query.refinement import refine
from scoup.query.select import Reshaping
from scoup.query.thing_judge import Shares, ThingIndex, Verdict, compared_words, thing_index
from scoup.query.thing_names import named_things
from scoup.query.things import Thing, things_of_table
from scoup.query.view_answer import ViewAnswer, mask_box
from scoup.query.votes import level_thresholds, select_by_relevancy

__all__ = [
    "Answer",
    "AnswerFiles",
    "Certainty",
    "Expression",
    "ExpressionAnswer",
    "FieldView",
    "Frame",
    "GaussianLabels",
    "LabelFiles",
    "LanguageField",
    "Named",
    "OrientedBox",
    "Place",
    "PointSets",
    "Question",
    "Reshaping",
    "Several",
    "Shares",
    "SplatTable",
    "TextScore",
    "TextVectors",
    "Thing",
    "ThingIndex",
    "Verdict",
    "ViewAnswer",
    "answers_of",
    "build",
    "check_encoder",
    "compare",
    "compared_words",
    "draw_things",
    "drawing",
    "edit_picture",
    "edited",
    "encode_texts",
    "find_named",
    "heat_frames",
    "level_thresholds",
    "make_question",
    "mask_box",
    "named_things",
    "near_names",
    "parse_expression",
    "placed_atoms",
    "presence_threshold",
    "refine",
    "related_objects",
    "save_catalog",
    "save_comparison",
    "select_by_relevancy",
    "text_scores",
    "texts_of",
    "thing_index",
    "thing_mask",
    "things_of_question",
    "things_of_table",
    "warn_of_another_model",
]
