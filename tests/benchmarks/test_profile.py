import json

from benchmarks.profile import main


def test_a_profile_names_every_stage(models, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("nilbs.engine.compiled._threads", None)  # the program changes it
    path = tmp_path / "model.nilbs"
    models[3].save(path)
    assert main([str(path), "--points", "500", "--threads", "1", "--json", str(tmp_path / "profile.json")]) == 0
    found = json.loads((tmp_path / "profile.json").read_text())
    assert found["points"] == 500
    assert found["bandwidth_gb_s"] > 0
    for near in found["sets"].values():
        assert min(near["stages"].values()) >= 0
        assert near["look_ups"] > 0
    printed = capsys.readouterr().out
    assert all(stage in printed for stage in found["sets"]["near"]["stages"])
